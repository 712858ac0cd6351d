"""Material and light on a capture's true mesh: error on unseen views and under other lights against seconds.

The fast solvers, the same with path-traced refinement, the path tracer alone (tuned, and with the paper's settings)
and other programs. Each of our scenes is path traced where no fit has looked, by the same renderer; a peer's is shown
by the peer.
"""

from __future__ import annotations

import tempfile
import time
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
from hir_core.stages.reflectance.initial_scene import initial_scene
from hir_core.stages.reflectance.path_traced_refinement import refine_by_path_tracing
from hir_core.stages.reflectance.reflectance_fit import fit_reflectance
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.inputs.bench_captures import decoded, true_scene
from hir_plugins.commands.bench.inputs.scene_judge import Judge
from hir_plugins.commands.bench.measurement import peak_bytes, reset_peak
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

EFFORTS = (0.0625, 0.125, 0.25, 0.5, 1.0)
REFINED_EFFORT, PATH_TRACED_STEPS = 0.5, 20
TUNED_STEPS = (50, 150)
PAPER_STEPS = (100,)
"""Of 32,000 that the paper takes with 80 photographs."""
FITTED = ModelSpec("dielectric", "uniform", bounces=1)
DOWNSAMPLE = 2
TUNED = ReflectanceSettings(
    renderer="mitsuba_ggx",
    method="gradient",
    brdf="dielectric",
    model="specular",
    downsample=DOWNSAMPLE,
    gradient=GradientSettings(learning_rate=0.02, learning_rate_end=0.1),
)


def fits(path: Path, plan: Plan) -> Iterator[Row]:
    """A row for each method and budget; none where the capture has no true mesh."""
    train = decoded(read_capture(path, "train", plan.plugins))
    scene = true_scene(path, train)
    if scene is None:
        return
    judge = Judge(path, plan.plugins, DOWNSAMPLE)
    side = max(train.cameras[0].width // DOWNSAMPLE, 1)
    case: Case = {"capture": path.name, "views": len(train.views), "image": side}
    with tempfile.TemporaryDirectory(prefix="hir-bench-") as folder:
        bench = _Bench(plan, Path(folder), train, scene, judge, case)
        for found in plan.plugins.components("reflectance_renderer"):
            if "solver" in found.component.traits and not found.missing:
                yield from bench.solver(found.component.name, EFFORTS[2:3] if plan.quick else EFFORTS)
        if plan.quick:
            return
        yield from bench.path_tracer("mitsuba_ggx, tuned", TUNED, {}, TUNED_STEPS)
        paper = load_config(plan.plugins, "paper")
        options = paper.reflectance_renderer
        yield from bench.path_tracer("mitsuba_ggx, the paper's settings", paper.reflectance, options, PAPER_STEPS)
    if plan.peers:
        yield from _peers(scene, train, case, path, plan, judge)


@dataclass(frozen=True)
class _Bench:
    """What all methods are given."""

    plan: Plan
    folder: Path
    train: Capture
    scene: Scene
    judge: Judge
    case: Case

    def solver(self, name: str, efforts: tuple[float, ...]) -> Iterator[Row]:
        """A renderer with a solver of its own, textures included, and one of its fits with path-traced refinement."""
        renderer = self.plan.plugins.create("reflectance_renderer", name, {})
        start = initial_scene(self.scene, self.train, ReflectanceSettings())
        every = range(len(self.train.views))

        def fitted(effort: float) -> tuple[Scene, str]:
            solver = renderer.prepare(start, self.train, DOWNSAMPLE)
            assert isinstance(solver, ReflectanceSolver)
            fit = solver.fit(FITTED, None, every, effort, lambda share: None)
            return solver.scene(fit, every, lambda share: None).scene, ""

        for effort in efforts:
            yield self._row(name, f"effort {effort:g}", partial(fitted, effort))

        def path_traced() -> tuple[Scene, str]:
            settings = replace(TUNED, path_tracing=PathTracingSettings("mitsuba_ggx", iterations=PATH_TRACED_STEPS))
            scene, _ = fitted(REFINED_EFFORT)
            scene, report = refine_by_path_tracing(scene, self.train, settings, Energies({}), self._context({}))
            gain = f"held-out views {report.gain_db:+.2f} ± {report.standard_error_db:.2f} dB"
            return scene, f"{gain}: {'accepted' if report.accepted else 'rejected'}"

        if len(efforts) > 1:
            yield self._row(
                f"{name} + path tracing", f"effort {REFINED_EFFORT:g}, {PATH_TRACED_STEPS} steps", path_traced
            )

    def path_tracer(
        self, name: str, settings: ReflectanceSettings, options: Mapping[str, Any], budgets: tuple[int, ...]
    ) -> Iterator[Row]:
        """Gradient steps through the path tracer from constant textures and a constant light."""
        context = self._context({"reflectance_renderer": options})
        for steps in budgets:
            gradient = replace(settings.gradient, iterations=steps, iterations_per_view=0)
            asked = replace(settings, gradient=gradient)

            def run(asked: ReflectanceSettings = asked) -> tuple[Scene, str]:
                scene, _ = fit_reflectance(self.scene, self.train, asked, context)
                return scene, f"at 1/{asked.downsample} of the size"

            yield self._row(name, f"{steps} steps", run)

    def _row(self, name: str, budget: str, run: Callable[[], tuple[Scene, str]]) -> Row:
        before = reset_peak()
        wall, cpu = time.perf_counter(), time.process_time()
        scene, note = run()
        seconds, spent, after = time.perf_counter() - wall, time.process_time() - cpu, peak_bytes()
        memory = None if before is None or after is None else max(0, after - before)
        timing = Timing(seconds, seconds, seconds, 1, spent, memory)
        return Row({**self.case, "budget": budget}, name, "ours", timing, self.judge(scene, FITTED.bounces), note)

    def _context(self, options: Mapping[str, Any]) -> StageContext:
        folder = Path(tempfile.mkdtemp(dir=self.folder))
        (folder / "checkpoints").mkdir()
        return StageContext(self.plan.plugins, folder, options, checkpoint_seconds=3600.0)


def _peers(scene: Scene, train: Capture, case: Case, path: Path, plan: Plan, judge: Judge) -> Iterator[Row]:
    from hir_plugins.commands.bench.peers.color_map import color_map_rows
    from hir_plugins.commands.bench.peers.stock_mitsuba import stock_rows

    start = initial_scene(scene, train, ReflectanceSettings())
    lit = replace(scene, environment=start.environment)
    for rows in (stock_rows, color_map_rows):
        try:
            yield from rows(lit, train, judge.captures["test"], case, path, plan)
        except (ImportError, HirError) as error:
            budget = {**case, "budget": "–"}
            yield Row(budget, rows.__name__.removesuffix("_rows"), "peer", None, note=f"not run: {error}")
