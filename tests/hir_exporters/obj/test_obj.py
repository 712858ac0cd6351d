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
    name = report.files[1].stem
    assert name.startswith("a_ball_") and name != "a_ball", "another file may have the name without the space"
    text = report.files[1].read_text()
    assert f"map_Kd {name}_obj_base_color.png" in text and f"norm {name}_obj_normal.png" in text and "map_Pr" in text


def test_constants_beside_maps_are_their_means(textured_asset: Asset, tmp_path: Path) -> None:
    """A reader that knows Pr and Pm but not their maps shows the average surface: no metal for a non-metal."""
    report = create_exporter("obj").write(textured_asset, tmp_path / "x.obj")
    values = dict(line.split(" ", 1) for line in report.files[1].read_text().splitlines() if " " in line)
    assert "map_Pm" in values and float(values["Pm"]) < 0.1
    np.testing.assert_allclose(float(values["Pr"]), np.sqrt(textured_asset.material.roughness).mean(), atol=0.01)


def test_constants_need_no_images_and_bytes_repeat(constant_asset: Asset, tmp_path: Path) -> None:
    first = create_exporter("obj").write(constant_asset, tmp_path / "a" / "x.obj")
    second = create_exporter("obj").write(constant_asset, tmp_path / "b" / "x.obj")
    assert [p.name for p in first.files] == ["x.obj", "x.mtl"]
    assert [p.read_bytes() for p in first.files] == [p.read_bytes() for p in second.files]
