"""Every profile × format of meshes from one triangle to a million, for every validator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import validate_exports
from hir_exporters.asset import Asset, AssetMaterial, AssetMesh
from hir_exporters.formats import create_exporter
from hir_exporters.reading.validators import Finding, validate_gltf, validate_omniverse, validate_usd

Texture = Callable[..., np.ndarray]


@pytest.fixture(autouse=True)
def _validators(node_tools: Path) -> None:
    """The tests skip where a validator is not installed."""
    pytest.importorskip("omni.asset_validator", reason="omniverse-asset-validator needs Python < 3.13")


def plate(columns: int, rows: int, triangles: int = 1 << 30) -> AssetMesh:
    """A bent sheet of 2 * columns * rows triangles, or the first few of them."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    positions = np.stack([u - 0.5, 0.5 - v, 0.1 * np.sin(6 * u)], axis=-1).reshape(-1, 3)
    slope = 0.6 * np.cos(6 * u)
    normals = np.stack([-slope, 0 * u, np.ones_like(u)], axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    b, c, d = a + columns + 1, a + columns + 2, a + 1
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=1).reshape(-1, 3)[:triangles]
    used, faces = np.unique(faces, return_inverse=True)
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)
    return AssetMesh(positions[used], normals[used], uvs[used], faces.reshape(-1, 3))


def lines(findings: list[Finding]) -> list[str]:
    return [f"{f.file.name}: {f.severity} {f.code} {f.message}" for f in findings]


@pytest.mark.parametrize("triangles", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_one_and_two_triangles(triangles: int, textured_asset: Asset, tmp_path: Path) -> None:
    asset = replace(textured_asset, mesh=plate(1, 1, triangles))
    assert len(asset.mesh.faces) == triangles
    files = validate_exports.export_variants(asset, tmp_path)
    assert len(files) >= 17
    assert lines(validate_exports.problems(validate_exports.validate(files))) == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "suffix", "config"), list(validate_exports.variants()))
def test_a_million_triangles(
    name: str, suffix: str, config: object, textured_asset: Asset, node_tools: Path, tmp_path: Path
) -> None:
    """NVIDIA's rules are left out: in Python, they take minutes for a fifth of that."""
    asset = replace(textured_asset, mesh=plate(1000, 500))
    assert len(asset.mesh.faces) == 1_000_000
    report = create_exporter(suffix, config).write(asset, tmp_path / f"{name}.{suffix}")
    files = [file for file in report.files if file.suffix == f".{suffix}"]
    findings = validate_gltf(files, node_tools) if suffix in ("glb", "gltf") else validate_usd(files)
    assert lines(validate_exports.problems(findings)) == []


@pytest.mark.slow
@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_every_kind_of_material(model: str, textured_asset: Asset, make_texture: Texture, tmp_path: Path) -> None:
    kinds = {
        "constant": AssetMaterial(model, [0.5] * 3, [0.1] * 3, 0.2),
        "colored": replace(textured_asset.material, model=model),
        "metal": AssetMaterial(model, [0.0] * 3, make_texture(16, 3, 0.4, 0.95), make_texture(16, 1, 0.1, 0.5)[..., 0]),
    }
    for name, material in kinds.items():
        files = validate_exports.export_variants(replace(textured_asset, material=material), tmp_path / name)
        assert lines(validate_exports.problems(validate_exports.validate(files))) == [], name


def test_the_tool_reports_problems_by_its_exit_code(
    textured_asset: Asset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hir_exporters.scene_format import save_scene

    save_scene(replace(textured_asset, mesh=plate(1, 1)), tmp_path / "run" / "scene")
    assert validate_exports.main(["--no-nvidia", str(tmp_path / "run")]) == 0
    assert "0 problems" in capsys.readouterr().out
    layer = tmp_path / "x_openpbr.usda"
    unknown = Finding(layer, "error", "MissingShaderIdInRegistry", "shader 'Phong'")
    materialx = replace(unknown, message="shader 'ND_open_pbr_surface_surfaceshader'")
    elsewhere = replace(materialx, file=tmp_path / "x.usda")
    hint = Finding(tmp_path / "x.glb", "information", "UNUSED_OBJECT", "")
    assert validate_exports.problems([unknown, materialx, elsewhere, hint]) == [unknown, elsewhere]
    assert validate_exports.main([str(tmp_path / "run")], lambda files, nvidia: [unknown, hint]) == 1
    assert "Phong" in capsys.readouterr().out


def test_nvidias_validator_would_complain(tmp_path: Path) -> None:
    (tmp_path / "bad.usda").write_text('#usda 1.0\ndef Mesh "x" { int[] faceVertexCounts = [3] }\n')
    assert {"error"} <= {finding.severity for finding in validate_omniverse([tmp_path / "bad.usda"])}
