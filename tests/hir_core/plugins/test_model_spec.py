"""Candidates of model selection: names, kinds, and combinations that make no sense."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hir_core.plugins.model_spec import ModelSpec

METAL = ModelSpec("metallic", "uniform", metalness="metal")


@pytest.mark.parametrize(
    ("spec", "kind", "name"),
    [
        (ModelSpec(), "diffuse", "diffuse"),
        (ModelSpec("paper", "uniform"), "paper", "paper, specular"),
        (ModelSpec("dielectric", "uniform"), "dielectric", "dielectric, specular"),
        (METAL, "metal", "metal"),
        (replace(METAL, roughness="map", bounces=1), "metal", "metal, roughness map, 1 bounce"),
        (replace(METAL, metalness="map"), "mixed", "metal and dielectric"),
    ],
)
def test_kind_and_name(spec: ModelSpec, kind: str, name: str) -> None:
    assert (spec.kind, spec.name) == (kind, name)


def test_a_metalness_map_is_a_map_and_a_uniform_metal_is_not() -> None:
    assert not METAL.mapped
    assert replace(METAL, metalness="map").mapped


@pytest.mark.parametrize("change", [{"metalness": "none"}, {"specular": "map"}, {"colored": True}, {"brdf": "paper"}])
def test_contradictions_are_refused(change: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="metal"):
        replace(METAL, **change)  # type: ignore[arg-type]
