"""What reading a file back must notice: each difference is one sentence, and what may differ is none."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset
from hir_exporters.errors import ExportError, InputError
from hir_exporters.formats import create_exporter
from hir_exporters.reading.file_verification import compare_with_asset, read_back, verify_file
from hir_exporters.reading.readback import ReadBack


@pytest.fixture
def written(textured_asset: Asset, tmp_path: Path) -> Path:
    create_exporter("glb").write(textured_asset, tmp_path / "x.glb")
    return tmp_path / "x.glb"


def changed(back: ReadBack, **values: object) -> ReadBack:
    return dataclasses.replace(back, **values)  # type: ignore[arg-type]


def test_a_file_that_keeps_everything_has_no_problems(written: Path, textured_asset: Asset) -> None:
    found = verify_file(written, textured_asset)
    assert found.problems == () and found.positions < 1e-6 and found.uvs < 1e-6 and found.normals_degrees < 0.1


def test_each_difference_is_a_sentence(written: Path, textured_asset: Asset) -> None:
    back, name = read_back(written), written.name
    size = float(np.linalg.norm(np.ptp(textured_asset.mesh.positions, axis=0)))
    moved = compare_with_asset(
        written, textured_asset, changed(back, corner_positions=back.corner_positions + 0.01 * size)
    )
    assert moved.problems[0].startswith(f"{name}: positions differ by 0.01") and moved.positions > 9e-3
    shifted = compare_with_asset(written, textured_asset, changed(back, corner_uvs=back.corner_uvs + 0.02))
    assert shifted.problems == (f"{name}: texture coordinates differ by 0.02",)
    normals = back.corner_normals + 0.1 * back.corner_normals[..., [1, 2, 0]]
    turned = compare_with_asset(written, textured_asset, changed(back, corner_normals=normals))
    assert len(turned.problems) == 1 and "normals differ by" in turned.problems[0] and turned.normals_degrees > 2
    had = back.normal is not None
    other = compare_with_asset(
        written, textured_asset, changed(back, normal=None if had else np.ones((2, 2, 3), np.float32))
    )
    assert other.problems == (
        f"{name}: the normal map is missing" if had else f"{name}: it has a normal map, the asset has none",
    )
    fewer = changed(back, **{f: getattr(back, f)[1:] for f in ("corner_positions", "corner_normals", "corner_uvs")})
    count = len(textured_asset.mesh.faces)
    assert compare_with_asset(written, textured_asset, fewer).problems == (
        f"{name} has {count - 1} triangles instead of {count}",
    )


def test_what_no_reader_knows_is_refused(tmp_path: Path, textured_asset: Asset) -> None:
    with pytest.raises(ExportError, match=r"no independent reader checks '\.stl'"):
        read_back(tmp_path / "x.stl")
    for suffix in ("glb", "gltf", "usda"):
        for untrusted in (False, True):
            with pytest.raises(InputError, match="does not exist"):
                read_back(tmp_path / f"gone.{suffix}", untrusted=untrusted)
