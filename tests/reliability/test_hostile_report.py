"""report.html of a stranger's run: nothing in it is markup, and no picture from outside the run is embedded."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.errors import HirError
from hir_exporters.textures.image_files import encode_png

from hir_core.plugins.manager import PluginManager
from hir_core.report import refresh_page
from hir_core.run.run_directory import RunDirectory
from tests.reliability import seeds

MARKUP = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>"
PICTURE = encode_png(np.full((3, 4, 3), 0.5, np.float32))
KINDS = ("true", "fit", "difference")


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    """A run with pictures of one fitted and one evaluated view, beside a picture that it must not embed."""
    folder = tmp_path / "run"
    folder.mkdir()
    seeds.run(folder)
    directory = RunDirectory(folder)
    for place in (directory.report, directory.evaluation("test")):
        place.mkdir(parents=True)
        for kind in KINDS:
            (place / f"a_{kind}.png").write_bytes(PICTURE)
    write(directory.report / "views.json", fitted())
    write(directory.evaluation("test") / "metrics.json", evaluated())
    (tmp_path / "secret.png").write_bytes(PICTURE)
    return directory


def write(path: Path, document: object) -> None:
    path.write_text(json.dumps(document))


def fitted(**more: object) -> dict[str, Any]:
    view = {"name": "a", "object": 25.0, "frame": 30.0, **{kind: f"a_{kind}.png" for kind in KINDS}}
    return {"views": [view | more], "stages": {}}


def evaluated(file: str = "a.png", **psnr: object) -> dict[str, Any]:
    return {"views": [{"name": "a", "file": file, "psnr": {"object": 25.0, "frame": 30.0} | psnr}]}


def page(run: RunDirectory) -> str:
    return refresh_page(run, PluginManager.discover()).read_text(encoding="utf-8")


def with_markup(value: Any) -> Any:
    """The document with markup in every text of it."""
    if isinstance(value, dict):
        return {key: with_markup(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_markup(inner) for inner in value]
    return value + MARKUP if isinstance(value, str) else value


def test_text_of_a_run_is_never_markup(run: RunDirectory) -> None:
    document = run.read_run()
    kept = {key: document[key] for key in ("format", "version", "metrics")}
    write(run.path / "run.json", with_markup(document) | kept)
    timings = run.read_timings()
    write(run.path / "timings.json", timings | {"machine": with_markup(timings["machine"])})
    write(run.report / "views.json", fitted(name=MARKUP, extra=MARKUP, measured_at=[640, 480]))
    metrics = evaluated(**{MARKUP: MARKUP, "name": MARKUP, "kind": MARKUP})
    metrics["views"][0]["name"] = MARKUP
    write(run.evaluation("test") / "metrics.json", metrics)
    text = page(run)
    assert "&lt;script&gt;alert(1)" in text and "measured at 640×480" in text
    assert "<script>alert" not in text and "<img src=x" not in text


@pytest.mark.parametrize("size", [MARKUP, [MARKUP, MARKUP], [1], {"a": 1}, 3])
def test_a_size_that_is_no_size_is_refused(size: object, run: RunDirectory) -> None:
    write(run.report / "views.json", fitted(measured_at=size))
    with pytest.raises(HirError, match="damaged"):
        page(run)
    write(run.report / "views.json", fitted())
    write(run.evaluation("test") / "metrics.json", evaluated(measured_at=size))
    with pytest.raises(HirError, match="damaged"):
        page(run)


@pytest.mark.parametrize("kind", KINDS)
def test_no_picture_from_outside_is_embedded(kind: str, run: RunDirectory) -> None:
    secret = run.path.parent / "secret.png"
    for name in ("../../secret.png", str(secret), "..\\..\\secret.png", "", ".", 3):
        write(run.report / "views.json", fitted(**{kind: name}))
        with pytest.raises(HirError, match="not a plain file name"):
            page(run)
    write(run.report / "views.json", fitted())
    # psnr may have any key, and none of them names a file
    write(run.evaluation("test") / "metrics.json", evaluated(**{kind: "../../../secret.png"}))
    assert page(run)


def test_no_link_of_a_run_leads_out_of_it(run: RunDirectory) -> None:
    secret = run.path.parent / "secret.png"
    for place in (run.report / "a_true.png", run.evaluation("test") / "a_fit.png", run.report / "light.png"):
        content = place.read_bytes() if place.exists() else None
        place.unlink(missing_ok=True)
        place.symlink_to(secret)
        with pytest.raises(HirError, match="leads out of"):
            page(run)
        place.unlink()
        if content is not None:
            place.write_bytes(content)
    assert page(run)


def test_the_report_has_the_policy_of_the_viewer_and_frames_of_its_own(run: RunDirectory) -> None:
    def policy(text: str) -> dict[str, str]:
        [content] = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
        return dict(part.strip().partition(" ")[::2] for part in content.split(";"))

    from hir_plugins.commands.viewer.three_modules import page_folder

    viewer = policy((page_folder() / "page.html").read_text(encoding="utf-8"))
    own = policy(page(run))
    assert own["default-src"] == "'none'"
    assert {key: own[key] for key in viewer} == viewer, "the viewer's page inherits the policy of its frame's owner"
    assert set(own) - set(viewer) == {"frame-src", "base-uri", "form-action"}
