"""`hir check` on the sample capture, and on one that was spoilt."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import read_ldr, write_png

from tests.fixtures.command_line import hir

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample_capture"


def test_json_table_and_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("check", SAMPLE, "--json", "--sheet", tmp_path / "sheet.png") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["reader"] == "transforms_json" and document["with_camera"] == len(document["views"]) == 24
    assert all(view["agreement"] > 0.8 and view["mask_share"] > 0.1 for view in document["views"])
    assert read_ldr(tmp_path / "sheet.png").shape == (3 * 160, 8 * 160, 3)


def test_a_wrong_mask_is_named_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spoilt = tmp_path / "capture"
    shutil.copytree(SAMPLE, spoilt)
    victim = sorted((spoilt / "train").glob("*.png"))[5]
    picture = read_ldr(victim)
    picture[..., 3] = np.roll(picture[..., 3], 40, axis=1)
    write_png(victim, picture)
    assert hir("check", spoilt) == 0
    printed = capsys.readouterr().out
    assert f"→ the masks of {victim.stem} disagree with the others" in printed
    assert "24 photographs of 256×256 (transforms_json), 24 cameras, 24 masks" in printed


def test_takes_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture = tmp_path / "capture"
    shutil.copytree(SAMPLE, capture)
    file = capture / "transforms_train.json"
    content = json.loads(file.read_text())
    for i, frame in enumerate(content["frames"]):
        frame["take"] = "upside_down" if i % 8 == 0 else "standing"
    file.write_text(json.dumps(content))
    assert hir("check", capture, "-q") == 0
    printed = capsys.readouterr().out
    assert "24 masks, 2 takes (upside_down 3, standing 21)" in printed
    assert "→ the take upside_down has 3 photographs, so its light is under-observed" in printed
    assert hir("check", capture, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["takes"] == [{"name": "upside_down", "photographs": 3}, {"name": "standing", "photographs": 21}]
    assert [view["take"] for view in document["views"]][:2] == ["upside_down", "standing"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{sample}", "--sheet", "{tmp}/sheet.jpg"], "the contact sheet is a PNG"),
        (["{sample}", "--mesh", "{tmp}/none.obj"], "none.obj: no such file"),
        (["{tmp}"], "no capture that an installed reader knows"),
        (["{sample}", "--split", "lunch"], "no split 'lunch'"),
    ],
)
def test_wrong_input(arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("check", *(w.format(sample=SAMPLE, tmp=tmp_path) for w in arguments)) == 2
    printed = capsys.readouterr().err
    assert message in printed and "Traceback" not in printed


def test_no_heavy_package_is_imported() -> None:
    code = (
        "import sys\nfrom hir_core.cli.app import cli\n"
        f"cli.main(['check', {str(SAMPLE)!r}, '-q'], standalone_mode=False)\n"
        "assert not {'torch', 'mitsuba', 'drjit', 'open3d', 'cv2'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_a_mesh_shows_whether_the_light_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import trimesh

    trimesh.creation.icosphere(subdivisions=3, radius=0.5).export(tmp_path / "ball.obj")
    assert hir("check", SAMPLE, "--mesh", tmp_path / "ball.obj", "-q", "--sheet", tmp_path / "sheet.png") == 0
    output = capsys.readouterr().out.splitlines()
    assert output[0].startswith("24 photographs of 256×256 (transforms_json), 24 cameras, 24 masks")
    assert "light follows the camera: " in output[0] and str(tmp_path / "sheet.png") not in output
    (tmp_path / "empty.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name, message in (("none.obj", "no such file"), ("empty.obj", "vertices that are not finite")):
        assert hir("check", SAMPLE, "--mesh", tmp_path / name) == 2
        assert message in capsys.readouterr().err
