"""The lamp near the camera in scenes, assets and files, and what a change of the unit of length makes of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import hir_exporters
import numpy as np
import pytest
import torch
from hir_exporters.asset import Asset, validate_asset
from hir_exporters.asset_health import asset_health
from hir_exporters.asset_lamp import AssetLamp
from hir_exporters.content_cache import asset_key
from hir_exporters.errors import InputError
from hir_exporters.formats import create_exporter
from hir_exporters.mesh.placement import placed_asset
from hir_exporters.scene_format import load_scene, save_scene

from hir_core.scene import CameraLamp, EnvironmentMap, Material, Scene
from hir_core.scene.asset_conversion import bake, scene_from_asset
from hir_core.scene.frames import move_scene
from hir_core.scene.scene_store import load_stage_scene, save_stage_scene
from hir_core.stages.atlas import unwrap_mesh
from tests.fixtures.scenes import icosphere

LAMP = CameraLamp(torch.tensor([4.0, 3.0, 2.0]), torch.tensor([0.1, -0.2, 0.05]), torch.tensor(1.5), torch.tensor(0.25))
DESCRIPTION = {"intensity": [4.0, 3.0, 2.0], "offset": [0.1, -0.2, 0.05], "exponent": 1.5, "radius": 0.25}


def lamp_scene() -> Scene:
    material = Material("dielectric", torch.full((3,), 0.5), torch.full((3,), 0.04), torch.tensor([0.2]))
    return Scene(unwrap_mesh(icosphere(1), 64)[0], material, EnvironmentMap(torch.rand(4, 8, 3), lamp=LAMP))


def lamp_of(scene: Scene) -> CameraLamp:
    assert scene.environment is not None and scene.environment.lamp is not None
    return scene.environment.lamp


def assert_lamp(found: Any, factor: float = 1.0) -> None:
    """`factor` of all lengths: the light that reaches the object is the same."""
    for name, power in (("intensity", 2), ("offset", 1), ("exponent", 0), ("radius", 1)):
        expected = factor**power * np.asarray(getattr(LAMP, name))
        np.testing.assert_allclose(np.asarray(getattr(found, name)), expected, rtol=1e-6, err_msg=name)


def test_the_lamp_of_a_stage_comes_back(tmp_path: Path) -> None:
    save_stage_scene(lamp_scene(), tmp_path / "scene")
    assert_lamp(lamp_of(load_stage_scene(tmp_path / "scene")))
    dark = replace(lamp_scene(), environment=EnvironmentMap(torch.rand(4, 8, 3)))
    save_stage_scene(dark, tmp_path / "dark")
    environment = load_stage_scene(tmp_path / "dark").environment
    assert environment is not None and environment.lamp is None


def test_the_lamp_of_an_asset_comes_back(tmp_path: Path) -> None:
    asset = bake(lamp_scene())
    save_scene(asset, tmp_path / "scene")
    loaded = load_scene(tmp_path / "scene")
    assert loaded.environment is not None
    assert_lamp(loaded.environment.lamp)
    assert_lamp(lamp_of(scene_from_asset(loaded)))
    assert asset_health(asset).has_camera_lamp and "lamp near the camera" in asset_health(asset).sentence()


def test_scenes_before_lamps_had_a_radius_have_points_of_light(tmp_path: Path) -> None:
    save_scene(bake(lamp_scene()), tmp_path / "asset")
    path = tmp_path / "asset" / "scene.json"
    document = json.loads(path.read_text())
    del document["environment"]["lamp"]["radius"]
    path.write_text(json.dumps(document))
    loaded = load_scene(tmp_path / "asset").environment
    assert loaded is not None and loaded.lamp is not None and loaded.lamp.radius == 0
    save_stage_scene(lamp_scene(), tmp_path / "stage")
    with np.load(tmp_path / "stage" / "arrays.npz") as stored:
        arrays = {name: stored[name] for name in stored.files if name != "lamp.radius"}
    np.savez(tmp_path / "stage" / "arrays.npz", **arrays)
    assert float(lamp_of(load_stage_scene(tmp_path / "stage")).radius) == 0


def test_a_scene_with_a_lamp_follows_the_schema(tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="the schema is checked with jsonschema")
    schema = json.loads((Path(hir_exporters.__file__).parent / "scene.schema.json").read_text())
    save_scene(bake(lamp_scene()), tmp_path / "scene")
    document = json.loads((tmp_path / "scene" / "scene.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(document)
    document["environment"]["lamp"]["exponent"] = -1
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(schema).validate(document)


def test_a_larger_world_has_a_brighter_lamp_farther_from_the_camera() -> None:
    matrix = np.diag([3.0, 3.0, 3.0, 1.0])
    assert_lamp(lamp_of(move_scene(lamp_scene(), matrix)), 3)
    environment = placed_asset(bake(lamp_scene()), matrix).environment
    assert environment is not None
    assert_lamp(environment.lamp, 3)


def test_files_describe_the_lamp(tmp_path: Path) -> None:
    asset = bake(lamp_scene())
    create_exporter("gltf").write(asset, tmp_path / "ball.gltf")
    document = json.loads((tmp_path / "ball.gltf").read_text())
    found = document["asset"]["extras"]["hir"]["camera_lamp"]
    assert {name: np.round(value, 6).tolist() for name, value in found.items()} == DESCRIPTION
    assert "KHR_lights_punctual" not in document.get("extensionsUsed", [])


def changed(asset: Asset, **values: Any) -> Asset:
    assert asset.environment is not None and asset.environment.lamp is not None
    return replace(asset, environment=replace(asset.environment, lamp=replace(asset.environment.lamp, **values)))


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"intensity": np.array([1.0, -1.0, 1.0])}, "intensity has negative values"),
        ({"offset": np.array([0.0, np.nan, 0.0])}, "lamp.offset"),
        ({"offset": np.zeros(2)}, "lamp.offset has the shape"),
        ({"exponent": -1.0}, "exponent is -1.0"),
        ({"radius": float("nan")}, "radius is nan"),
    ],
)
def test_an_impossible_lamp_is_refused(values: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        validate_asset(changed(bake(lamp_scene()), **values))


@pytest.mark.parametrize("broken", [{"intensity": [1, 2]}, {"offset": "near"}, {"exponent": None}])
def test_a_damaged_lamp_in_a_file_is_refused(tmp_path: Path, broken: dict[str, Any]) -> None:
    save_scene(bake(lamp_scene()), tmp_path / "scene")
    file = tmp_path / "scene" / "scene.json"
    document = json.loads(file.read_text())
    document["environment"]["lamp"] |= broken
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"environment\.lamp\."):
        load_scene(tmp_path / "scene")


def test_results_are_not_shared_between_lamps() -> None:
    asset = bake(lamp_scene())
    assert asset_key(asset) != asset_key(changed(asset, exponent=2.0))
    assert isinstance(asset.environment.lamp, AssetLamp)  # type: ignore[union-attr]
