from pathlib import Path

import numpy as np
import trimesh
from hir_exporters.asset import Asset
from hir_exporters.formats import create_exporter


def test_another_library_reads_the_same_surface(textured_asset: Asset, tmp_path: Path) -> None:
    report = create_exporter("obj").write(textured_asset, tmp_path / "a ball.obj")
    mesh = trimesh.load(tmp_path / "a ball.obj", process=False, maintain_order=True)
    ours = textured_asset.mesh
    np.testing.assert_allclose(mesh.vertices[mesh.faces], ours.positions[ours.faces], atol=1e-8)
    np.testing.assert_allclose(mesh.visual.uv[mesh.faces] * [1, -1] + [0, 1], ours.uvs[ours.faces], atol=1e-7)
    assert all(path.is_file() for path in report.files)
    text = (tmp_path / "a_ball.mtl").read_text()
    assert "map_Kd a_ball_base_color.png" in text and "norm a_ball_normal.png" in text and "map_Pr" in text


def test_constants_need_no_images_and_bytes_repeat(constant_asset: Asset, tmp_path: Path) -> None:
    first = create_exporter("obj").write(constant_asset, tmp_path / "a" / "x.obj")
    second = create_exporter("obj").write(constant_asset, tmp_path / "b" / "x.obj")
    assert [p.name for p in first.files] == ["x.obj", "x.mtl"]
    assert [p.read_bytes() for p in first.files] == [p.read_bytes() for p in second.files]
