"""The `metallic` model in torch: parameters and albedos, on disk, as an asset and back, within energy conservation."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.asset import AssetMaterial

from hir_core.errors import InputError
from hir_core.scene import Material, Scene
from hir_core.scene.asset_conversion import bake, scene_from_asset
from hir_core.scene.energy_conservation import with_conserved_energy
from hir_core.scene.scene_store import load_stage_scene, save_stage_scene
from hir_core.stages.atlas import unwrap_mesh
from tests.fixtures.scenes import bumpy_sphere


def mixed(size: int = 16) -> Material:
    """Metal, plastic and texels in between; F0 0.06."""
    generator = torch.Generator().manual_seed(0)
    metalness = torch.rand(size, size, 1, generator=generator)
    metalness[: size // 3], metalness[-size // 3 :] = 0, 1
    base = torch.rand(size, size, 3, generator=generator)
    return Material.metallic(base, metalness, torch.rand(size, size, 1, generator=generator), dielectric_f0=0.06)


def scene() -> Scene:
    mesh, _ = unwrap_mesh(bumpy_sphere(2), 64)
    return Scene(mesh, mixed())


def test_albedos_are_those_of_the_exporters_and_exact_at_both_ends() -> None:
    base, alpha = torch.rand(8, 8, 3), torch.tensor([0.3])
    for m in (torch.zeros(1), torch.ones(1), torch.rand(8, 8, 1)):
        ours = Material.metallic(base, m, alpha, dielectric_f0=0.07)
        theirs = AssetMaterial.metallic(base.numpy(), m.numpy()[..., 0], 0.3, dielectric_f0=0.07)
        exact = m.ndim == 1
        np.testing.assert_allclose(ours.diffuse_albedo, theirs.diffuse_albedo, atol=0 if exact else 1e-7, rtol=0)
        np.testing.assert_allclose(ours.specular_albedo, theirs.specular_albedo, atol=0 if exact else 1e-7, rtol=0)
        np.testing.assert_allclose(ours.base_color, base, atol=0 if exact else 3e-7, rtol=0)


def test_gradients_reach_base_colour_and_metalness() -> None:
    inputs = [torch.rand(2, 2, c, dtype=torch.float64, requires_grad=True) for c in (3, 1)]

    def albedos(base: torch.Tensor, metalness: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        made = Material.metallic(base, metalness, torch.tensor([0.3]))
        return made.diffuse_albedo, made.specular_albedo

    assert torch.autograd.gradcheck(albedos, inputs)


def test_parameters_without_their_model_are_refused() -> None:
    grey, alpha = torch.full((3,), 0.5), torch.tensor([0.3])
    with pytest.raises(InputError, match=r"needs metalness; make it with Material\.metallic"):
        Material("metallic", grey, grey, alpha)
    with pytest.raises(InputError, match="metalness is only for the model 'metallic', not for 'dielectric'"):
        Material("dielectric", grey, grey, alpha, metalness=torch.zeros(1))
    with pytest.raises(InputError, match="dielectric_f0 is only for the model 'metallic', not for 'paper'"):
        Material("paper", grey, grey, alpha, dielectric_f0=0.05)
    with pytest.raises(InputError, match="'paper' has no base colour"):
        _ = Material("paper", grey, grey, alpha).base_color
    with pytest.raises(InputError, match="4 rows and 8 columns, metalness 5 and 3"):
        Material.metallic(torch.ones(4, 8, 3), torch.ones(5, 3, 1), alpha)


def test_stage_scene_keeps_every_bit(tmp_path: Path) -> None:
    for name, material in (("texture", mixed()), ("constant", Material.metallic(*map(torch.ones, (3, 1, 1))))):
        before = replace(scene(), material=material)
        save_stage_scene(before, tmp_path / name)
        after = load_stage_scene(tmp_path / name).material
        assert after is not None and after.model == "metallic" and after.dielectric_f0 == material.dielectric_f0
        for field in fields(material):
            value = getattr(material, field.name)
            if isinstance(value, torch.Tensor):
                assert torch.equal(getattr(after, field.name), value), field.name


def test_asset_and_back() -> None:
    before = scene()
    asset = bake(before)
    assert asset.material.model == "metallic" and asset.material.dielectric_f0 == 0.06
    after = scene_from_asset(asset).material
    assert after is not None and before.material is not None and before.material.metalness is not None
    assert after.dielectric_f0 == 0.06 and after.metalness is not None
    torch.testing.assert_close(after.metalness, before.material.metalness, rtol=0, atol=0)
    torch.testing.assert_close(after.base_color, before.material.base_color, rtol=0, atol=5e-7)
    torch.testing.assert_close(after.diffuse_albedo, before.material.diffuse_albedo, rtol=0, atol=5e-7)


def test_a_baked_base_colour_and_metalness_are_clamped() -> None:
    outside = Material.metallic(torch.tensor([1.5, 0.5, -0.5]), torch.tensor([0.5]), torch.tensor([0.3]))
    np.testing.assert_array_equal(bake(Scene(bumpy_sphere(1), outside)).material.base_color, [1, 0.5, 0])
    above = Material.metallic(torch.tensor([0.9, 0.5, 0.1]), torch.tensor([1.25]), torch.tensor([0.3]))
    baked = bake(Scene(bumpy_sphere(1), above)).material
    assert baked.metalness is not None and float(baked.metalness) == 1 and baked.diffuse_albedo.tolist() == [0, 0, 0]


def test_energy_is_conserved_by_base_colour_and_metalness() -> None:
    valid = mixed()
    same, changed = with_conserved_energy(valid)
    torch.testing.assert_close(same.specular_albedo, valid.specular_albedo, rtol=0, atol=5e-7)
    assert changed == 0 and same.metalness is not None and same.dielectric_f0 == 0.06
    base = torch.full((2, 2, 3), 0.5)
    base[0, 0], base[1, 1, 0] = 1.5, torch.nan
    conserved, changed = with_conserved_energy(Material.metallic(base, torch.full((2, 2, 1), 0.5), torch.ones(1)))
    assert changed == pytest.approx(4 / 12)
    wanted = torch.full((2, 2, 3), 0.5)
    wanted[0, 0], wanted[1, 1, 0] = 1.0, 0.0
    torch.testing.assert_close(conserved.base_color, wanted)
    assert conserved.model == "metallic" and bool(torch.isfinite(conserved.diffuse_albedo).all())
