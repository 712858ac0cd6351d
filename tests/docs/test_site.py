"""The documentation builds as a site without a warning, and its generated pages are those that the code gives."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.checkout import DOCS, ROOT, tool

REFERENCE = tool("write_reference").pages()


@pytest.mark.parametrize("place", REFERENCE)
def test_generated_page_is_what_the_code_gives(place: str) -> None:
    written = (DOCS / place).read_text(encoding="utf-8")
    assert written == REFERENCE[place], "run: python tools/write_reference.py"


def test_reference_names_every_hook_and_every_option() -> None:
    from hir_core.plugins import hookspecs
    from hir_core.plugins.manager import PluginManager

    hooks = REFERENCE["reference/hooks.md"]
    assert all(f"## {name}\n" in hooks for name in vars(hookspecs) if name.startswith("hir_"))
    options = REFERENCE["reference/options.md"]
    for registered in PluginManager.discover().components():
        if registered.distribution == "hir":
            fields = getattr(registered.component.config, "__dataclass_fields__", {})
            assert all(f"| `{name}` |" in options for name in fields), registered.component.name


def test_every_contract_has_its_section() -> None:
    from hir_core.testing import all_checks

    page = (DOCS / "writing_plugins" / "contracts.md").read_text(encoding="utf-8")
    for name, check in all_checks().items():
        assert f"### {name}\n" in page and check.section.endswith(f"contracts.md#{name}")
        assert check.contract.endswith("."), name


def test_interface_is_as_it_was_noted() -> None:
    """A change of hooks, base classes or types is written down, and noted where its users look."""
    api = tool("write_public_api")
    stored = (DOCS / "reference" / "public_api.txt").read_text(encoding="utf-8")
    now = api.page()
    changed = sorted(set(now.splitlines()) ^ set(stored.splitlines()))
    assert now == stored, f"the plugin interface changed: {changed[:6]}; run: python tools/write_public_api.py"
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"plugin interface {api.interface_hash(stored)}" in changes, (
        f"CHANGELOG.md does not say what changed in the plugin interface; note it with the words "
        f"'plugin interface {api.interface_hash(stored)}'"
    )


@pytest.mark.parametrize(
    "change",
    ["a hook's argument", "a new abstract method", "a field of a type", "a trait", "a check"],
)
def test_each_kind_of_change_is_noticed(change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from hir_core import testing
    from hir_core.plugins import component, hookspecs, interfaces, traits

    api = tool("write_public_api")
    before = api.page()
    if change == "a hook's argument":
        wider = hookspecs.hookspec(lambda stage, scene, report, seconds: None)
        monkeypatch.setattr(hookspecs, "hir_stage_finished", wider)
    elif change == "a new abstract method":
        monkeypatch.setattr(interfaces.Regularizer, "finish", lambda self: None, raising=False)
    elif change == "a field of a type":
        fields = dict(component.Component.__dataclass_fields__)
        del fields["summary"]
        monkeypatch.setattr(component.Component, "__dataclass_fields__", fields)
    elif change == "a trait":
        monkeypatch.setattr(traits, "TRAITS", {**traits.TRAITS, "exporter": {"fast": "quick"}})
    else:
        fewer = {name: check for name, check in testing.all_checks().items() if name != "white_furnace"}
        monkeypatch.setattr(testing, "all_checks", lambda: fewer)
    assert api.interface_hash(api.page()) != api.interface_hash(before)


def test_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("material", reason="mkdocs-material is not installed: pip install -e '.[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}  # the theme advertises
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    page = (tmp_path / "site" / "writing_plugins" / "contracts.html").read_text(encoding="utf-8")
    assert 'id="gradient_is_that_of_the_value"' in page, "messages of failures name this anchor"
    remote = [word for word in page.split('"') if word.startswith("http") and "://" in word]
    assert not [word for word in remote if word.endswith((".js", ".css", ".woff2"))], "the site fetches nothing"
