"""Material and light on a capture's true mesh: time against error on unseen views and under other lights.

The fast solvers, the same with path-traced refinement, the path tracer alone (tuned, and with the paper's settings)
and other programs. Our scenes are all rendered by the same path tracer from views that no fit uses; the result of
another program is rendered by that program.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from hir_core.capture import Capture
from hir_core.config import GradientSettings, PathTracingSettings, ReflectanceSettings, load_config
from hir_core.errors import HirError
from hir_core.intake.reader_lookup import read_capture
from hir_core.optimization.weighted_energies import Energies
from hir_core.plugins.interfaces import ReflectanceSolver
from hir_core.plugins.model_spec import ModelSpec
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.stages.reflectance.initial_material_and_light import initial_scene
from hir_core.stages.reflectance.path_traced_refinement import refine_by_path_tracing
from hir_core.stages.reflectance.reflectance_fit import fit_reflectance
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_scene
from hir_plugins.commands.bench.inputs.scene_evaluator import SceneEvaluator
from hir_plugins.commands.bench.measurement import Stopwatch
from hir_plugins.commands.bench.peers.color_map import color_map_rows
from hir_plugins.commands.bench.peers.stock_mitsuba import TIME_LIMITS_S, stock_rows
from hir_plugins.commands.bench.results.bench_result import Case, Row


@dataclass(frozen=True)
class FitBudgets:
    """How long each method fits."""

    efforts: tuple[float, ...] = (0.0625, 0.125, 0.25, 0.5, 1.0)
    """Of solvers: the fraction of their full budget."""
    refined_effort: float = 0.5
    """Of the solver's fit that path tracing refines."""
    path_traced_steps: int = 20
    tuned_steps: tuple[int, ...] = (50, 150)
    paper_steps: tuple[int, ...] = (100,)
    """The paper uses 32,000 for 80 photographs."""
    stock_limits_s: tuple[float, ...] = TIME_LIMITS_S
    """Of stock Mitsuba."""


FITTED_MODEL = ModelSpec("dielectric", "uniform", bounces=1)
DOWNSAMPLE = 2
TUNED = ReflectanceSettings(
    renderer="mitsuba_ggx",
    method="gradient",
    brdf="dielectric",
    model="specular",
    downsample=DOWNSAMPLE,
    gradient=GradientSettings(learning_rate=0.02, learning_rate_end=0.1),
)


def reflectance_rows(options: BenchOptions) -> Iterator[Row]:
    """Rows for each capture with a true mesh."""
    for path in options.captures:
        yield from fit_rows(path, options)


def fit_rows(path: Path, bench_options: BenchOptions, budgets: FitBudgets = FitBudgets()) -> Iterator[Row]:
    """A row for each method and budget; none if the capture has no true mesh."""
    train = decode_images(read_capture(path, "train", bench_options.plugins))
    scene = true_scene(path, train)
    if scene is None:
        return
    evaluator = SceneEvaluator(path, bench_options.plugins, DOWNSAMPLE)
    side = max(train.cameras[0].width // DOWNSAMPLE, 1)
    case: Case = {"capture": path.name, "views": len(train.views), "image": side}
    with tempfile.TemporaryDirectory(prefix="hir-bench-") as folder:
        benchmark = FitBenchmark(bench_options, budgets, Path(folder), train, scene, evaluator, case)
        for registered in bench_options.plugins.components("reflectance_renderer"):
            if "solver" in registered.component.traits and not registered.missing:
                efforts = budgets.efforts[2:3] if bench_options.quick else budgets.efforts
                yield from benchmark.solver(registered.component.name, efforts)
        if bench_options.quick:
            return
        yield from benchmark.path_tracer("mitsuba_ggx, tuned", TUNED, {}, budgets.tuned_steps)
        paper = load_config(bench_options.plugins, "paper")
        options = paper.reflectance_renderer
        yield from benchmark.path_tracer(
            "mitsuba_ggx, the paper's settings", paper.reflectance, options, budgets.paper_steps
        )
    if bench_options.peers:
        yield from _peer_rows(scene, train, case, path, bench_options, budgets, evaluator)


@dataclass(frozen=True)
class FitBenchmark:
    """The task that all methods share."""

    bench_options: BenchOptions
    budgets: FitBudgets
    folder: Path
    train: Capture
    scene: Scene
    evaluator: SceneEvaluator
    case: Case

    def solver(self, name: str, efforts: tuple[float, ...]) -> Iterator[Row]:
        """A renderer's own solver, textures included, and one of its fits with path-traced refinement."""
        renderer = self.bench_options.plugins.create("reflectance_renderer", name, {})
        start = initial_scene(self.scene, self.train, ReflectanceSettings())
        every = range(len(self.train.views))

        def fitted(effort: float) -> tuple[Scene, str]:
            solver = renderer.prepare(start, self.train, DOWNSAMPLE)
            assert isinstance(solver, ReflectanceSolver)
            # a short fit takes fewer pixels, too
            fit = solver.fit(FITTED_MODEL, None, every, effort, lambda share: None, pixel_share=min(1.0, 2 * effort))
            return solver.scene(fit, every, lambda share: None).scene, ""

        for effort in efforts:
            yield self._row(name, f"effort {effort:g}", partial(fitted, effort))

        def path_traced() -> tuple[Scene, str]:
            settings = replace(
                TUNED, path_tracing=PathTracingSettings("mitsuba_ggx", iterations=self.budgets.path_traced_steps)
            )
            scene, _ = fitted(self.budgets.refined_effort)
            scene, report = refine_by_path_tracing(scene, self.train, settings, Energies({}), self._context({}))
            gain = f"held-out views {report.gain_db:+.2f} ± {report.standard_error_db:.2f} dB"
            return scene, f"{gain}: {'accepted' if report.accepted else 'rejected'}"

        if len(efforts) > 1:
            yield self._row(
                f"{name} + path tracing",
                f"effort {self.budgets.refined_effort:g}, {self.budgets.path_traced_steps} steps",
                path_traced,
            )

    def path_tracer(
        self, name: str, settings: ReflectanceSettings, options: Mapping[str, Any], step_counts: tuple[int, ...]
    ) -> Iterator[Row]:
        """Gradient steps through the path tracer from constant textures and a constant light."""
        context = self._context({"reflectance_renderer": options})
        for steps in step_counts:
            gradient = replace(settings.gradient, iterations=steps, iterations_per_view=0)
            limited = replace(settings, gradient=gradient, map_errors=False)

            def run(limited: ReflectanceSettings = limited) -> tuple[Scene, str]:
                scene = fit_reflectance(self.scene, self.train, limited, context).scene
                return scene, f"at 1/{limited.downsample} of the size"

            yield self._row(name, f"{steps} steps", run)

    def _row(self, name: str, budget: str, run: Callable[[], tuple[Scene, str]]) -> Row:
        stopwatch = Stopwatch()
        scene, note = run()
        timing = stopwatch.timing()
        errors = self.evaluator(scene, FITTED_MODEL.bounces)
        return Row({**self.case, "budget": budget}, name, "ours", timing, errors, note)

    def _context(self, options: Mapping[str, Any]) -> StageContext:
        folder = Path(tempfile.mkdtemp(dir=self.folder))
        (folder / "checkpoints").mkdir()
        return StageContext(self.bench_options.plugins, folder, options, checkpoint_seconds=3600.0)


def _peer_rows(
    scene: Scene,
    train: Capture,
    case: Case,
    path: Path,
    bench_options: BenchOptions,
    budgets: FitBudgets,
    evaluator: SceneEvaluator,
) -> Iterator[Row]:
    start = initial_scene(scene, train, ReflectanceSettings())
    lit = replace(scene, environment=start.environment)
    peers: dict[str, Callable[..., Iterator[Row]]] = {
        "stock": partial(stock_rows, time_limits_s=budgets.stock_limits_s),
        "color_map": color_map_rows,
    }
    for name, rows in peers.items():
        try:
            yield from rows(lit, train, evaluator.captures["test"], case, path, bench_options)
        except (ImportError, HirError) as error:
            yield Row({**case, "budget": "–"}, name, "peer", None, note=f"not run: {error}")
