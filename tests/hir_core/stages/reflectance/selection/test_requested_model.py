"""The model that the settings name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.requested_model import default_spec, forced_spec

METAL = ModelSpec("metallic", "uniform", metalness="metal")
METALLIC = ReflectanceSettings(brdf="metallic")


def test_the_metallic_brdf_by_its_settings() -> None:
    """`auto` compares metal with metal and dielectric, or lets metalness vary where a model is named; the model adds
    maps, and the light frame is kept.
    """
    assert forced_spec(METALLIC) is None
    assert default_spec(METALLIC) == forced_spec(replace(METALLIC, model="specular")) == replace(METAL, metalness="map")
    assert forced_spec(replace(METALLIC, metalness="metal", model="specular")) == METAL
    rough = forced_spec(replace(METALLIC, metalness="metal", model="roughness_map", light_frame="camera"))
    assert rough == replace(METAL, roughness="map", light_frame="camera")
    assert forced_spec(replace(METALLIC, model="per_texel_brdf")) == replace(METAL, metalness="map", per_texel="brdf")
    assert forced_spec(replace(METALLIC, model="normal_map")) == replace(METAL, metalness="map", normals="map")
    assert forced_spec(replace(METALLIC, model="diffuse")) == ModelSpec()


def test_a_specular_map_of_metal_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"whose base colour is always a map; choose reflectance.model=specular"):
        forced_spec(replace(METALLIC, model="specular_map"))


def test_other_brdfs_are_compared_or_named_as_before() -> None:
    assert forced_spec(ReflectanceSettings()) is None
    assert default_spec(ReflectanceSettings()) == ModelSpec("dielectric", "uniform")
    assert forced_spec(ReflectanceSettings(model="roughness_map", brdf="paper")) == ModelSpec("paper", "map", "map")
