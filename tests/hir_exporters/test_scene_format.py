import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh, describe, validate_asset
from hir_exporters.errors import ExportError, InputError
from hir_exporters.formats import create_exporter
from hir_exporters.mesh.vertex_welding import weld
from hir_exporters.scene_format import load_scene, save_scene


def leaves(asset: Asset) -> dict[str, object]:
    found: dict[str, object] = {}
    for part in (asset.mesh, asset.material, asset.environment):
        if part is not None:
            found |= {f"{type(part).__name__}.{f.name}": getattr(part, f.name) for f in dataclasses.fields(part)}
    return found | {"name": asset.name, "provenance": dict(asset.provenance)}


@pytest.mark.parametrize("kind", ["textured_asset", "constant_asset"])
def test_a_scene_comes_back_bit_by_bit(tmp_path: Path, kind: str, request: pytest.FixtureRequest) -> None:
    asset = request.getfixturevalue(kind)
    save_scene(asset, tmp_path / "scene")
    loaded = leaves(load_scene(tmp_path / "scene"))
    for name, value in leaves(asset).items():
        if name == "AssetMesh.uvs":  # stored with t up: 1 - v rounds once
            np.testing.assert_allclose(loaded[name], value, atol=2.0**-24, rtol=0)
        else:
            np.testing.assert_array_equal(loaded[name], value, err_msg=name)


def test_saving_twice_gives_the_same_bytes_and_loading_them_again_too(tmp_path: Path, textured_asset: Asset) -> None:
    save_scene(textured_asset, tmp_path / "a")
    save_scene(load_scene(tmp_path / "a"), tmp_path / "b")
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == sorted(p.name for p in (tmp_path / "b").iterdir()) and "environment.exr" in names
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_mesh_is_readable_by_others_and_welds(tmp_path: Path, textured_asset: Asset) -> None:
    import trimesh

    save_scene(textured_asset, tmp_path / "s")
    mesh = trimesh.load(tmp_path / "s" / "mesh.ply", process=False)
    np.testing.assert_array_equal(mesh.vertices, textured_asset.mesh.positions)
    np.testing.assert_array_equal(mesh.faces, textured_asset.mesh.faces)
    first, group = weld(textured_asset.mesh.positions)
    np.testing.assert_array_equal(textured_asset.mesh.positions[first][group], textured_asset.mesh.positions)
    assert trimesh.Trimesh(textured_asset.mesh.positions[first], group[textured_asset.mesh.faces]).is_watertight


def test_tangents_are_kept(tmp_path: Path, constant_asset: Asset) -> None:
    tangents = np.tile(np.float32([1, 0, 0, -1]), (len(constant_asset.mesh.positions), 1))
    asset = dataclasses.replace(constant_asset, mesh=dataclasses.replace(constant_asset.mesh, tangents=tangents))
    save_scene(asset, tmp_path / "s")
    np.testing.assert_array_equal(load_scene(tmp_path / "s").mesh.tangents, tangents)


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path, constant_asset: Asset) -> None:
    (tmp_path / "thesis.tex").write_text("years")
    with pytest.raises(ExportError, match=r"thesis\.tex"):
        save_scene(constant_asset, tmp_path)
    assert (tmp_path / "thesis.tex").read_text() == "years"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["version"], 99, "version"),
        (["version"], True, "version"),
        (["format"], "other", "not a scene"),
        (["mesh"], "../mesh.ply", "outside the scene"),
        (["mesh"], "/etc/passwd", "outside the scene"),
        (["mesh"], "C:\\mesh.ply", "outside the scene"),
        (["mesh"], None, "does not name"),
        (["mesh"], "link.ply", "link to outside"),
        (["mesh"], "none.ply", "none.ply"),
        (["mesh"], "a" * 5000, "cannot be opened: File name too long"),
        (["mesh"], "scene.json", "not a PLY"),
        (["material"], 3, "material is not"),
        (["material", "model"], "phong", "phong"),
        (["material", "roughness"], None, "roughness is missing"),
        (["material", "roughness"], [0.3], "roughness"),
        (["material", "roughness"], 0.0, "roughness"),
        (["material", "roughness"], "diffuse_albedo.exr", "colour"),
        (["material", "diffuse_albedo"], [1, "a", 1], "not a number"),
        (["material", "diffuse_albedo"], [1e400, 0, 0], "NaN or infinite"),
        (["material", "diffuse_albedo"], "mesh.ply", "OpenEXR"),
        (["material", "normal"], [0, 0, 1], "normal"),
        (["environment", "to_world"], [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "rotation"),
        (["environment", "to_world"], [1, 0, 0], "to_world"),
        (["environment", "frame"], "moon", "moon"),
        (["name"], "", "name"),
        (["name"], 7, "name"),
    ],
)
def test_a_wrong_entry_is_named(
    tmp_path: Path, textured_asset: Asset, path: list[str], value: object, message: str
) -> None:
    scene = tmp_path / "scene"
    save_scene(textured_asset, scene)
    (tmp_path / "outside.ply").write_bytes((scene / "mesh.ply").read_bytes())
    (scene / "link.ply").symlink_to(tmp_path / "outside.ply")
    document = json.loads((scene / "scene.json").read_text())
    table = document
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value
    (scene / "scene.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=message) as caught:
        load_scene(scene)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'{"a":' * 100_000, b"\xff\xfe"])
def test_scene_json_that_is_no_object_is_named(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "scene.json").write_bytes(data)
    with pytest.raises(InputError, match=r"scene\.json"):
        load_scene(tmp_path)
    with pytest.raises(InputError, match=r"scene\.json"):
        load_scene(tmp_path / "nowhere")


def test_scrambled_meshes_never_escape_as_other_errors(tmp_path: Path, constant_asset: Asset) -> None:
    save_scene(constant_asset, tmp_path / "s")
    data = (tmp_path / "s" / "mesh.ply").read_bytes()
    rng = np.random.default_rng(0)
    for trial in range(120):
        scrambled = bytearray(data[: len(data) if trial % 2 else int(rng.integers(0, len(data)))])
        for index in rng.integers(0, max(1, min(len(scrambled), 300)), 4):
            if scrambled:
                scrambled[index] = rng.integers(256)
        (tmp_path / "s" / "mesh.ply").write_bytes(scrambled)
        try:
            validate_asset(load_scene(tmp_path / "s"))
        except InputError as error:
            assert str(tmp_path) in str(error)


def replaced(asset: Asset, part: str, name: str, value: object) -> Asset:
    return dataclasses.replace(asset, **{part: dataclasses.replace(getattr(asset, part), **{name: value})})


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("mesh", "positions", [[np.nan, 0, 0]] * 323),
        ("mesh", "positions", [[0, 0]] * 323),
        ("mesh", "positions", "abc"),
        ("mesh", "uvs", np.zeros((0, 2))),
        ("mesh", "uvs", [[np.inf, 0]] * 323),
        ("mesh", "normals", np.zeros((323, 3))),
        ("mesh", "faces", [[0, 1, 323]]),
        ("mesh", "faces", [[-1, 1, 2]]),
        ("mesh", "faces", []),
        ("mesh", "faces", [[0, 1, 2**40]]),
        ("mesh", "faces", [[0.5, 1, 2]]),
        ("mesh", "tangents", np.zeros((323, 4))),
        ("mesh", "tangents", np.tile([1, 0, 0, 0.5], (323, 1))),
        ("material", "model", "phong"),
        ("material", "diffuse_albedo", [2, 0, 0]),
        ("material", "diffuse_albedo", [-0.1, 0, 0]),
        ("material", "diffuse_albedo", 0.5),
        ("material", "diffuse_albedo", np.zeros((0, 4, 3))),
        ("material", "specular_albedo", [np.nan, 0, 0]),
        ("material", "specular_albedo", [1.5, 0, 0]),
        ("material", "roughness", 0.0),
        ("material", "roughness", [0.5]),
        ("material", "roughness", np.full((4, 4), np.nan)),
        ("material", "normal", np.zeros((4, 4, 3))),
        ("material", "normal", np.ones(3)),
        ("material", "observed", np.ones(4, bool)),
        ("environment", "radiance", -np.ones((4, 8, 3))),
        ("environment", "radiance", np.full((4, 8, 3), np.inf)),
        ("environment", "radiance", np.ones((4, 8))),
        ("environment", "to_world", np.ones((3, 3))),
        ("environment", "frame", "sun"),
    ],
)
def test_an_unusable_field_is_named(textured_asset: Asset, part: str, name: str, value: object) -> None:
    assert len(textured_asset.mesh.positions) == 323
    with pytest.raises(InputError, match=rf"{part}\.{name}"):
        validate_asset(replaced(textured_asset, part, name, value))


def test_unwritable_provenance_is_named(constant_asset: Asset) -> None:
    for provenance in ({"a": float("nan")}, {"a": object()}):
        with pytest.raises(InputError, match="provenance"):
            validate_asset(dataclasses.replace(constant_asset, provenance=provenance))


def test_description_counts_what_is_there(textured_asset: Asset) -> None:
    summary = describe(textured_asset)
    assert (summary["vertices"], summary["model"], summary["normal"]) == (323, "dielectric", "32 x 32")
    assert summary["environment"]["size"] == "64 x 32"
    json.dumps(summary, allow_nan=False)


def test_one_triangle_with_plain_lists_is_an_asset(tmp_path: Path) -> None:
    mesh = AssetMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1]] * 3, [[0, 1], [1, 1], [0, 0]], [[0, 1, 2]])
    asset = Asset(mesh, AssetMaterial("paper", [0.5] * 3, [0] * 3, 0.3), AssetEnvironment(np.ones((1, 2, 3))))
    save_scene(asset, tmp_path / "s")
    assert len(load_scene(tmp_path / "s").mesh.faces) == 1


def test_one_triangle_that_came_from_a_file_is_written_everywhere(tmp_path: Path) -> None:
    """Its only face is a record of the file: contiguous, but at an odd address."""
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    mesh = AssetMesh(corners, [[0, 0, 1]] * 3, [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    save_scene(Asset(mesh, AssetMaterial("paper", [0.5] * 3, [0.1] * 3, 0.3)), tmp_path / "scene")
    asset = load_scene(tmp_path / "scene")
    assert asset.mesh.faces.flags.aligned
    for name in ("glb", "usdz", "obj"):
        assert create_exporter(name).write(asset, tmp_path / f"x.{name}").files
