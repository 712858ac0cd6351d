"""Studies on forced fits: a constant changes everywhere and is restored; one fit at vertices serves several values."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from benchmarks import forced_fits
from benchmarks.default_values import DEFAULT_VALUES, MEASURES, TEXTURES
from benchmarks.forced_fits import NAMES, changed_constant, shared_fits, table, true_settings
from hir_core.config import load_config
from hir_core.errors import ConfigError
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from hir_plugins.reflectance_renderers.transport_ggx.textures import albedo_refinement, per_texel_maps, texture_solve


def test_a_constant_changes_in_all_modules_that_import_it_and_comes_back() -> None:
    modules = (texture_solve, albedo_refinement, per_texel_maps)
    with changed_constant(f"{TEXTURES}:TEXEL_PRIOR_WEIGHT", 0.3):
        assert [module.TEXEL_PRIOR_WEIGHT for module in modules] == [0.3] * 3
    assert [module.TEXEL_PRIOR_WEIGHT for module in modules] == [DEFAULT_VALUES["texel_prior_weight"].value] * 3
    with pytest.raises(ConfigError, match="no module has NOTHING"), changed_constant(f"{TEXTURES}:NOTHING", 1.0):
        pass


def solver_of(positions: float, options: TransportGGXOptions) -> Any:
    surface = SimpleNamespace(positions=torch.full((3, 3), positions))
    return SimpleNamespace(_transport=SimpleNamespace(surface=surface), _options=options)


def test_fits_are_shared_by_mesh_and_options_and_only_from_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []

    def fit(solver: object, spec: ModelSpec, initial: object, *more: object) -> object:
        made.append(initial)
        return object()

    monkeypatch.setattr(TransportSolver, "fit", fit)
    first, spec = TransportGGXOptions(), ModelSpec()
    with shared_fits():
        shared: Any = TransportSolver.fit

        def of(solver: object, initial: object = None, views: tuple[int, ...] = (0, 1)) -> object:
            return shared(solver, spec, initial, views, 1.0, print)

        one = of(solver_of(0.0, first))
        assert of(solver_of(0.0, first)) is one and len(made) == 1
        others = (
            of(solver_of(1.0, first)),
            of(solver_of(0.0, TransportGGXOptions(seed=1))),
            of(solver_of(0.0, TransportGGXOptions(light_whiteness=0.0))),
            of(solver_of(0.0, first), views=(0,)),
            of(solver_of(0.0, first), initial=one),
            of(solver_of(0.0, first), initial=one),
        )
        assert len({id(other) for other in (one, *others)}) == 7 and len(made) == 7
    assert TransportSolver.fit is fit


@pytest.mark.parametrize("kind", ["dielectric", "metal", "mixed"])
def test_a_fit_is_forced_to_the_truth(kind: Any) -> None:
    capture = MaterialsCapture(Path("x"), "tuning", kind, "camera", True)
    settings = load_config(PluginManager.discover(), assignments=true_settings(capture)).reflectance
    assert settings.light_frame == "camera" and settings.model == forced_fits.MODEL
    assert settings.brdf == ("dielectric" if kind == "dielectric" else "metallic")
    assert kind == "dielectric" or settings.metalness == {"metal": "metal", "mixed": "map"}[kind]


def test_the_table_pairs_candidates_with_today_inside_each_line() -> None:
    name, default = NAMES[1], DEFAULT_VALUES[NAMES[1]]
    values = (default.value, *default.candidates)

    def row(capture: str, seed: int, base: float) -> dict[str, Any]:
        decibels = {str(value): {error: base + number for error in MEASURES} for number, value in enumerate(values)}
        return {"constant": name, "half": "tuning", "capture": capture, "seed": seed, "decibels": decibels}

    # another base, as of other code, changes no gain
    lines = table([row("01_a", 0, 30.0), row("01_a", 1, 34.0), row("02_b", 0, 20.0)]).splitlines()
    first, last = default.candidates[0], default.candidates[-1]
    assert f"| {name} | {first} | {MEASURES[0]} | +1.00 (2) | +1.00 (1) | +1.00 ± 0.00 | better |" in lines
    assert f"| {name} | {last} | {MEASURES[1]} | +2.00 (2) | +2.00 (1) | +2.00 ± 0.00 | better |" in lines


def test_a_stored_line_is_not_measured_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    captures = [MaterialsCapture(tmp_path / name, "tuning", "metal", "world", True) for name in ("01_a", "02_b")]
    measured: list[tuple[str, str, int]] = []

    def run(name: str, value: object, capture: MaterialsCapture, seed: int, *more: object) -> object:
        measured.append((capture.name, name, seed))
        return SimpleNamespace(errors=dict.fromkeys(MEASURES, 30.0))

    monkeypatch.setattr(forced_fits, "run_with", run)
    monkeypatch.setattr(forced_fits, "find_captures", lambda *arguments: SimpleNamespace(captures=captures))
    store = tmp_path / "rows.jsonl"
    arguments = ["x", NAMES[1], "--materials", "m", "--workspace", "w", "--seeds", "0", "--store", str(store)]
    monkeypatch.setattr("sys.argv", arguments)
    forced_fits.main()
    assert {name for name, _, _ in measured} == {"01_a", "02_b"} and len(store.read_text().splitlines()) == 2
    measured.clear()
    monkeypatch.setattr("sys.argv", [*arguments, "--seeds", "0,1"])
    forced_fits.main()
    assert {seed for _, _, seed in measured} == {1} and len(store.read_text().splitlines()) == 4
