"""README and docs name only what exists."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from hir_core.cli.app import cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND_PAGE = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")


def commands() -> list[tuple[str, click.Command]]:
    """Every command of the engine and of the built-in plugins, with its path."""
    context = click.Context(cli, info_name="hir")
    found = []
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        if not (command.callback or cli.callback).__module__.startswith(("hir_core.", "hir_plugins.")):
            continue
        found.append((name, command))
        if isinstance(command, click.Group):
            found += [(f"{name} {sub}", child) for sub, child in command.commands.items()]
    return found


@pytest.mark.parametrize(("name", "command"), commands(), ids=[name for name, _ in commands()])
def test_command_page_describes_every_option(name: str, command: click.Command) -> None:
    """Not byte for byte: releases of click break lines differently."""
    _, _, section = COMMAND_PAGE.partition(f"## hir {name}\n")
    section = " ".join(section.partition("\n## ")[0].split())
    assert section, f"hir {name} is missing; run: python tools/write_command_page.py"
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert all(option in section for option in parameter.opts), parameter.opts
            assert " ".join((parameter.help or "").split()) in section, parameter.opts


def command_lines() -> list[str]:
    """Every line of a shell block of the pages that calls hir."""
    lines = []
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            lines += [line for line in block.splitlines() if line.startswith("hir ")]
    return lines


@pytest.mark.parametrize("line", command_lines())
def test_command_line_of_a_page_is_understood(line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    context = click.Context(cli, info_name="hir")
    command = cli.get_command(context, words[0])
    assert command is not None, line
    command.make_context(words[0], words[1:], resilient_parsing=False)


def test_python_of_the_readme_names_what_exists() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    import inspect

    from hir_core import reconstruct

    compile(code, "README.md", "exec")
    exec("\n".join(line for line in code.splitlines() if line.startswith("from ")), {})
    assert "preset" in inspect.signature(reconstruct).parameters
    assert (ROOT / "examples" / "sample_capture").is_dir()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)|<img src=\"([^\"]+)\"", page.read_text(encoding="utf-8")):
        link = target[0] or target[1]
        if not link.startswith("http"):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_make_targets_of_the_readme_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make (\S+)", (ROOT / "README.md").read_text(encoding="utf-8"), re.M):
        assert re.search(rf"^{re.escape(target)}:", makefile, re.M), target


CODE = re.compile(
    r"\b(?:hir_core|hir_plugins|exporters/hir_exporters|tests/\w+|tools|benchmarks|examples)/[\w./-]+\.(?:py|toml|json|md)\b"
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_of_the_repository_that_a_page_names_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [path for path in dict.fromkeys(CODE.findall(text)) if not (ROOT / path).is_file()] == []


def test_pages_that_the_code_names_exist() -> None:
    files = [
        f
        for layer in ("hir_core", "hir_plugins", "exporters")
        for f in (ROOT / layer).rglob("*")
        if f.suffix in (".py", ".toml")
    ]
    named = {(f, page) for f in files for page in re.findall(r"\bdocs/[\w/-]+\.md\b", f.read_text(encoding="utf-8"))}
    assert named
    assert sorted(f"{f.relative_to(ROOT)}: {page}" for f, page in named if not (ROOT / page).is_file()) == []
