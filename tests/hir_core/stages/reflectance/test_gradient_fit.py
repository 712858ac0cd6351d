"""The photometric loss and its fit, through a one-line renderer with known values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hir_exporters.conventions import linear_to_srgb

from hir_core.capture import Capture, Pixels, View
from hir_core.config import GradientSettings
from hir_core.errors import StageError
from hir_core.optimization.weighted_energies import Energies, prepare_energies
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages.reflectance.gradient_fit import ObjectPixels, PixelSampler, fit_by_gradient, object_pixels
from hir_core.stages.reflectance.reflectance_report import GradientReport
from hir_core.testing.scenes import sphere

RNG = np.random.default_rng(0)


class Product(PreparedReflectance):
    """Diffuse plus specular albedo times roughness, under the mean of the light; records the requested pixels."""

    def __init__(self, sick: Callable[[int], bool] = lambda call: False) -> None:
        self.asked: list[torch.Tensor] = []
        self._sick = sick

    def radiance(self, material: Material, environment: EnvironmentMap, pixels: torch.Tensor) -> torch.Tensor:
        self.asked.append(pixels)
        albedo = material.diffuse_albedo + material.specular_albedo * material.roughness
        shown = (albedo * environment.radiance.mean()).expand(len(pixels), 3)
        if self._sick(len(self.asked)):
            return torch.where(pixels[:, :1] == 1, torch.nan, shown)
        return shown


def view(name: str, color: np.ndarray, mask: np.ndarray | None, saturated: np.ndarray, exposure: float = 1.0) -> View:
    pixels = Pixels(color.astype(np.float32), mask, saturated)
    return View(name, None, lambda: pixels, exposure=exposure)


@pytest.fixture
def capture() -> Capture:
    """Two views of 4×3, the second exposed twice as long and without a mask."""
    color = [RNG.uniform(0.05, 0.9, (3, 4, 3)) for _ in range(2)]
    color[0][1, 2] = 0.1, 0.5, 0.19  # a clipped pixel; the start shows 0.2
    mask = np.zeros((3, 4), np.float32)
    mask[1, 2], mask[2, 0], mask[0, 0] = 1.0, 0.99, 0.98
    saturated = np.zeros((3, 4), bool)
    saturated[1, 2] = True
    none = np.zeros((3, 4), bool)
    return Capture(Path("made"), (view("a", color[0], mask, saturated), view("b", color[1], None, none, 2.0)))


def scene(model: str = "dielectric", **values: float) -> Scene:
    value = {"diffuse": 0.3, "specular": 0.2, "roughness": 0.5, "light": 0.5} | values
    material = Material(
        model,  # type: ignore[arg-type]
        torch.full((3,), value["diffuse"]),
        torch.full((3,), value["specular"]),
        torch.full((1,), value["roughness"]),
    )
    return Scene(sphere(), material, EnvironmentMap(torch.full((2, 4, 3), value["light"])))


def run(
    start: Scene,
    pixels: ObjectPixels,
    folder: Path,
    settings: GradientSettings,
    energies: Energies | None = None,
    prepared: PreparedReflectance | None = None,
    **more: Any,
) -> tuple[Material, torch.Tensor, GradientReport, dict[str, np.ndarray], list[str]]:
    """Material, light, report, curves and warnings of a fit."""
    blocks: list[Progress] = []
    warnings: list[str] = []
    seconds = more.pop("checkpoint_seconds", 30.0)
    context = StageContext(
        PluginManager(), folder, report=blocks.append, warn=warnings.append, checkpoint_seconds=seconds
    )
    steps = more.pop("steps", 5)
    fitted, report = fit_by_gradient(
        start, prepared or Product(), pixels, settings, energies or Energies({}), context, steps=steps, **more
    )
    assert fitted.material is not None and fitted.environment is not None
    curves = {name: np.concatenate([b.scalars[name] for b in blocks]) for name in blocks[0].scalars}
    return fitted.material, fitted.environment.radiance, report, curves, warnings


def test_pixels_of_the_object_with_their_colours_at_exposure_one(capture: Capture) -> None:
    found = object_pixels(capture, [0, 1], 1, "cpu")
    assert found.first == [0, 2, 14]
    assert found.index[:2].tolist() == [[0, 2, 1], [0, 0, 2]], "view, x, y; a mask of 0.98 is not inside"
    a, b = (v.read().color_linear for v in capture.views)
    np.testing.assert_array_equal(found.color[:2], np.stack([a[1, 2], a[2, 0]]))
    np.testing.assert_array_equal(found.color[2:], b.reshape(-1, 3) / np.float32(2))
    assert found.saturated.tolist() == [[True]] + [[False]] * 13
    assert found.color.dtype == torch.float32
    only = object_pixels(capture, [1], 1, "cpu")
    assert only.first == [0, 12] and set(only.index[:, 0].tolist()) == {1}


def test_masks_that_leave_nothing_are_one_sentence(capture: Capture) -> None:
    with pytest.raises(StageError, match=r"^made: the masks leave no pixel of the object; inspect them with: hir ch"):
        object_pixels(capture.__class__(capture.path, (_empty(capture.views[0]),)), [0], 1, "cpu")


def test_pixels_that_are_no_colours_are_counted_by_view(capture: Capture) -> None:
    pixels = capture.views[0].read()
    color = pixels.color_linear.copy()
    color[1, 2, 0], color[1, 2, 1], color[2, 0, 2] = np.nan, np.inf, -np.inf
    color[0, 0] = np.nan  # outside of the mask
    sick = replace(capture.views[0], read=lambda: replace(pixels, color_linear=color))
    with pytest.raises(
        StageError, match=r"^view a has 2 pixels of the object that are NaN or infinite; repair or remo"
    ):
        object_pixels(replace(capture, views=(sick,)), [0], 1, "cpu")
    color[1, 2], color[2, 0] = 0.5, 0.5
    assert len(object_pixels(replace(capture, views=(sick,)), [0], 1, "cpu").index) == 2


def _empty(view: View) -> View:
    pixels = replace(view.read(), mask=np.zeros((3, 4), np.float32))
    return replace(view, read=lambda: pixels)


@pytest.mark.parametrize("space", ["linear", "srgb"])
def test_the_loss_is_the_weighted_sum_of_absolute_differences(capture: Capture, tmp_path: Path, space: str) -> None:
    pixels = object_pixels(capture, [0, 1], 1, "cpu")
    settings = GradientSettings(rgb_weight=3.0, loss_space=space)  # type: ignore[arg-type]
    _, _, report, curves, warnings = run(scene(), pixels, tmp_path, settings, steps=1)
    shown = np.full((14, 3), (0.3 + 0.2 * 0.5) * 0.5)
    curve = (lambda x: x) if space == "linear" else linear_to_srgb
    difference = curve(shown) - curve(pixels.color.numpy().astype(np.float64))
    difference[0] = np.minimum(difference[0], 0)  # a clipped pixel is at least this bright
    assert (pixels.color[0].numpy() < shown[0]).any() and (pixels.color[0].numpy() > shown[0]).any()
    np.testing.assert_allclose(curves["rgb"][0], 3 * np.abs(difference).sum(), rtol=1e-5)
    np.testing.assert_allclose(curves["loss"], curves["rgb"])
    assert report == GradientReport(1, {}) and warnings == []


def test_regularizers_are_part_of_the_loss(capture: Capture, tmp_path: Path) -> None:
    pixels = object_pixels(capture, [0, 1], 1, "cpu")

    def energy(state: Scene) -> torch.Tensor:
        assert state.material is not None
        return (state.material.diffuse_albedo - 0.9).square().sum()

    pull = Energies({"far": (1e4, energy)})
    assert pull and not Energies({})
    material, _, _, curves, _ = run(scene(), pixels, tmp_path, GradientSettings(learning_rate=0.1), pull, steps=80)
    np.testing.assert_allclose(curves["far"][0], 1e4 * 3 * 0.36, rtol=1e-5)
    np.testing.assert_allclose(curves["loss"], curves["rgb"] + curves["far"], rtol=1e-5)
    np.testing.assert_allclose(material.diffuse_albedo, 0.9, atol=0.02)


def test_only_requested_parameters_are_fitted(capture: Capture, tmp_path: Path) -> None:
    pixels = object_pixels(capture, [0, 1], 1, "cpu")
    start = scene()
    assert start.material is not None
    for light in (False, True):
        for specular in (False, True):
            material, radiance, *_ = run(
                start, pixels, tmp_path, GradientSettings(), fit_light=light, fit_specular=specular
            )
            assert bool((radiance == 0.5).all()) is not light
            assert torch.equal(material.specular_albedo, start.material.specular_albedo) is not specular
            assert torch.equal(material.roughness, start.material.roughness) is not specular
            assert not torch.equal(material.diffuse_albedo, start.material.diffuse_albedo)
            values = material.diffuse_albedo, material.specular_albedo, material.roughness, radiance
            assert not any(t.requires_grad for t in values)
    material, radiance, *_ = run(start, pixels, tmp_path, GradientSettings())
    assert not bool((radiance == 0.5).all()) and not torch.equal(material.roughness, start.material.roughness)
    assert start.material.diffuse_albedo.tolist() == pytest.approx([0.3] * 3), "the start stays as it was"


def _bright(target: float) -> ObjectPixels:
    """Pixels far from anything that a material gives: every value runs into its limit."""
    count = 50
    color = torch.full((count, 3), target)
    return ObjectPixels(torch.zeros(count, 3, dtype=torch.long), color, torch.zeros(count, 1, dtype=bool), [0, count])


@pytest.mark.parametrize("model", ["paper", "dielectric"])
@pytest.mark.parametrize("conserve", [True, False])
def test_values_stay_in_their_range(tmp_path: Path, model: str, conserve: bool) -> None:
    settings = GradientSettings(learning_rate=0.5)
    up, light, *_ = run(scene(model), _bright(1e6), tmp_path, settings, steps=40, conserve_energy=conserve)
    torch.testing.assert_close(up.specular_albedo, torch.ones(3), rtol=0, atol=0)
    torch.testing.assert_close(up.roughness, torch.ones(1), rtol=0, atol=0)
    expected = 0.0 if model == "paper" and conserve else 1.0
    torch.testing.assert_close(up.diffuse_albedo, torch.full((3,), expected), rtol=0, atol=0)
    assert bool((light > 10).all())
    down, dark, *_ = run(scene(model), _bright(-1e6), tmp_path, replace(settings, loss_space="linear"), steps=40)
    torch.testing.assert_close(down.diffuse_albedo, torch.zeros(3), rtol=0, atol=0)
    torch.testing.assert_close(down.specular_albedo, torch.zeros(3), rtol=0, atol=0)
    torch.testing.assert_close(down.roughness, torch.full((1,), 0.01), rtol=0, atol=0)
    torch.testing.assert_close(dark, torch.zeros(2, 4, 3), rtol=0, atol=0)


def test_the_light_has_an_upper_end(tmp_path: Path) -> None:
    _, light, *_ = run(scene(light=99_000.0), _bright(1e9), tmp_path, GradientSettings(learning_rate=900.0), steps=4)
    torch.testing.assert_close(light, torch.full((2, 4, 3), 1e5), rtol=0, atol=0)


def test_the_rate_falls_to_its_end(tmp_path: Path) -> None:
    """Adam's first steps are as long as its rate: with an end of 0 the second of two is half as long."""
    moved = []
    for end in (1.0, 0.0):
        settings = GradientSettings(learning_rate=0.01, learning_rate_end=end, loss_space="linear")
        material, *_ = run(scene(), _bright(10.0), tmp_path, settings, steps=2, fit_light=False, fit_specular=False)
        moved.append(float(material.diffuse_albedo[0]) - 0.3)
    assert moved == pytest.approx([0.02, 0.015], abs=1e-5)


def test_a_step_sees_one_view_or_some_pixels_of_all(capture: Capture, tmp_path: Path) -> None:
    pixels = object_pixels(capture, [0, 1], 1, "cpu")
    shown = Product()
    run(scene(), pixels, tmp_path, GradientSettings(batch="views"), prepared=shown, steps=6)
    views = [sorted(set(asked[:, 0].tolist())) for asked in shown.asked]
    assert all(sorted(views[i] + views[i + 1]) == [0, 1] for i in (0, 2, 4)), "each once an epoch"
    assert {len(asked) for asked in shown.asked} == {2, 12}
    whole = PixelSampler(pixels, GradientSettings(batch_pixels=14), 0)
    assert whole(3).tolist() == list(range(14))
    some = PixelSampler(pixels, GradientSettings(batch_pixels=13), 0)
    assert len(some(0)) == 13 and some(0).tolist() == some(0).tolist() != some(1).tolist()
    assert some(0).tolist() != PixelSampler(pixels, GradientSettings(batch_pixels=13), 1)(0).tolist()
    drawn = torch.cat([some(i) for i in range(20)])
    assert int(drawn.min()) == 0 and int(drawn.max()) == 13
    many = replace(pixels, index=torch.zeros(30, 3, dtype=torch.long), first=list(range(31)))
    orders = [
        [int(PixelSampler(many, GradientSettings(batch="views"), seed)(i)[0]) for i in range(30)] for seed in (0, 1)
    ]
    assert orders[0] != orders[1] and sorted(orders[0]) == sorted(orders[1]) == list(range(30))


def test_nonfinite_pixels_are_counted_by_view_in_a_warning(capture: Capture, tmp_path: Path) -> None:
    pixels = object_pixels(capture, [0, 1], 1, "cpu")
    sick = Product(lambda call: call in (3, 4))
    material, _, report, _, warnings = run(scene(), pixels, tmp_path, GradientSettings(), prepared=sick)
    assert report == GradientReport(5, {"rgb": 1})
    assert warnings == ["1 of 5 steps were skipped: step 2: rgb is not finite at 12 pixels of view 1"]
    assert bool(torch.isfinite(material.diffuse_albedo).all())


def test_nonfinite_views_are_named(tmp_path: Path) -> None:
    """Of eight the first five."""
    index = torch.stack([torch.arange(8), torch.ones(8, dtype=torch.long), torch.zeros(8, dtype=torch.long)], dim=1)
    pixels = ObjectPixels(index, torch.ones(8, 3), torch.zeros(8, 1, dtype=torch.bool), list(range(9)))

    class Dark(Product):
        def radiance(self, material: Material, environment: EnvironmentMap, pixels: torch.Tensor) -> torch.Tensor:
            return super().radiance(material, environment, pixels) * torch.nan

    with pytest.raises(StageError, match=r"rgb is not finite at 8 pixels of view 0, 1, 2, 3, 4(?!,)"):
        run(scene(), pixels, tmp_path, GradientSettings(), prepared=Dark(), steps=30)


@pytest.mark.parametrize(
    ("field", "name"),
    [
        ("diffuse_albedo", "diffuse albedo"),
        ("specular_albedo", "specular albedo"),
        ("roughness", "roughness"),
        ("radiance", "light"),
    ],
)
def test_a_nonfinite_term_names_its_parameter(tmp_path: Path, field: str, name: str) -> None:
    start = scene()
    assert start.material is not None and start.environment is not None
    sick = torch.full((2, 4, 3) if field == "radiance" else (1,) if field == "roughness" else (3,), torch.nan)
    if field == "radiance":
        start = replace(start, environment=replace(start.environment, radiance=sick))
    else:
        start = replace(start, material=replace(start.material, **{field: sick}))

    class Constant(Product):
        def radiance(self, material: Material, environment: EnvironmentMap, pixels: torch.Tensor) -> torch.Tensor:
            return (
                0.5
                + 0 * sum(torch.nan_to_num(v).sum() for v in (material.diffuse_albedo, environment.radiance))
                + torch.zeros(len(pixels), 3)
            )

    def energy(state: Scene) -> torch.Tensor:
        assert state.material is not None and state.environment is not None
        return (state.environment.radiance if field == "radiance" else getattr(state.material, field)).sum()

    with pytest.raises(StageError, match=rf"stage reflectance: .*because of 'r' .*r is not finite at .*\b{name}\b"):
        run(
            start,
            _bright(1.0),
            tmp_path,
            GradientSettings(),
            Energies({"r": (1.0, energy)}),
            Constant(),
            steps=30,
            fit_specular=False,
        )


def test_the_state_is_stored_in_the_given_interval(tmp_path: Path) -> None:
    run(scene(), _bright(1.0), tmp_path, GradientSettings(), checkpoint_seconds=0.0)
    assert [p.name for p in (tmp_path / "checkpoints").iterdir()] == ["gradient.npz"]


def test_terms_are_weighted_and_left_out_by_settings() -> None:
    plugins = PluginManager.discover()
    context = StageContext(plugins, Path())
    bumpy = scene()
    table = {"edge_length": False, "laplacian": {"weight": 2.0}, "normal_consistency": {"weight": 0}}
    terms = prepare_energies(bumpy, table, context.plugins)  # type: ignore[arg-type]
    assert set(terms.terms) == {"laplacian"} and terms.terms["laplacian"][0] == 2.0
    plain = prepare_energies(bumpy, {"laplacian": {}}, context.plugins)
    assert float(terms(bumpy)["laplacian"]) == pytest.approx(2 * float(plain(bumpy)["laplacian"]), rel=1e-6)
    assert float(plain(bumpy)["laplacian"]) > 0
    other = prepare_energies(bumpy, {"laplacian": {"weight": 1.0, "cotangent": True}}, context.plugins)
    assert float(other(bumpy)["laplacian"]) != pytest.approx(float(plain(bumpy)["laplacian"]), rel=1e-3)
