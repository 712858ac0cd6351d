"""The optimisation loop: batches, schedule, non-finite steps, checkpoints, progress."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.errors import StageError
from hir_core.mesh.large_steps import LargeSteps, UniformAdam
from hir_core.optimization.checkpoints import load_checkpoint, save_checkpoint
from hir_core.optimization.optimization_loop import MAX_CONSECUTIVE_NONFINITE_STEPS, Checkpointing, optimize
from hir_core.optimization.schedules import Batches, Schedule
from hir_core.plugins.progress import Progress
from tests.fixtures.meshes import bumpy_sphere, mesh_of


def test_every_item_is_drawn_once_an_epoch_and_never_twice_in_a_batch() -> None:
    batches = Batches(10, 4, seed=3)
    drawn = [batches(step) for step in range(5)]
    assert all(len(set(batch)) == 4 for batch in drawn)
    assert sorted(drawn[0] + drawn[1] + drawn[2][:2]) == list(range(10))
    assert drawn == [Batches(10, 4, seed=3)(step) for step in range(5)]
    assert drawn != [Batches(10, 4, seed=4)(step) for step in range(5)]
    assert Batches(3, 8)(7) == [0, 1, 2]


def test_schedule_warms_up_and_ends_at_its_end() -> None:
    schedule = Schedule(100, warmup=10, end=0.1)
    assert schedule(0) == pytest.approx(0.1)
    assert schedule(9) == schedule(10) == pytest.approx(1.0)
    assert schedule(100) == pytest.approx(0.1)
    assert [Schedule(50)(s) for s in (0, 25, 50)] == [1.0, 1.0, 1.0]


def _line(value: float) -> tuple[torch.Tensor, torch.optim.Adam]:
    x = torch.tensor([value], requires_grad=True)
    return x, torch.optim.Adam([x], 0.1)


def test_it_finds_a_minimum_and_records_the_curves() -> None:
    x, optimizer = _line(3.0)
    report = optimize(
        lambda _: {"far": (x - 1).square().sum(), "flat": torch.zeros(())},
        optimizer,
        Schedule(300, end=0.01),
        stage="test",
    )
    assert x.item() == pytest.approx(1.0, abs=1e-3)
    assert report.steps == 300 and not report.skipped
    assert report.curves["far"].shape == (300,) and report.curves["far"][0] == pytest.approx(4.0)
    # the optimizer has its own learning rate again
    assert optimizer.param_groups[0]["lr"] == 0.1


def test_a_nonfinite_value_is_skipped_and_counted_under_its_term() -> None:
    x, optimizer = _line(3.0)

    def loss(step: int) -> dict[str, torch.Tensor]:
        bad = torch.tensor(float("nan") if step % 10 == 0 else 0.0)
        return {"good": (x - 1).square().sum(), "bad": bad + 0 * x.sum()}

    report = optimize(loss, optimizer, Schedule(200), stage="test")
    assert report.skipped == {"bad": 20}
    assert x.item() == pytest.approx(1.0, abs=0.05)


def test_a_nonfinite_gradient_of_a_finite_value_is_counted_under_its_term() -> None:
    x, optimizer = _line(0.5)

    def loss(step: int) -> dict[str, torch.Tensor]:
        # the root's slope at zero is infinite, its value is not
        root = ((x - x.detach()) if step == 3 else x).abs().sqrt().sum()
        return {"good": (x - 1).square().sum(), "root": 0.01 * root}

    assert optimize(loss, optimizer, Schedule(10), stage="test").skipped == {"root": 1}
    assert bool(torch.isfinite(x).all())


def test_only_nonfinite_steps_are_an_error_that_names_the_term() -> None:
    x, optimizer = _line(1.0)
    with pytest.raises(StageError, match=r"20 steps in a row.*'light'"):
        optimize(lambda _: {"light": x.sum() * float("inf")}, optimizer, Schedule(100), stage="test")
    assert MAX_CONSECUTIVE_NONFINITE_STEPS == 20 and x.item() == 1.0


@pytest.mark.parametrize(
    "make", [lambda p: torch.optim.Adam(p, 0.1), lambda p: UniformAdam(p, 0.1)], ids=["adam", "uniform"]
)
def test_a_resumed_loop_ends_where_an_unbroken_one_does(tmp_path: Path, make) -> None:
    def run(stop: int | None, path: Path, start: torch.Tensor) -> tuple[torch.Tensor, list[int], np.ndarray]:
        seen = Seen()
        x = start.clone().requires_grad_(True)
        optimizer = make([x])

        def loss(step: int) -> dict[str, torch.Tensor]:
            if step == stop:
                raise KeyboardInterrupt
            seen.steps.append(step)
            target = torch.tensor([float(i) for i in Batches(5, 3)(step)])
            return {"far": (x - target + torch.rand(3)).square().sum()}

        received: list[Progress] = []
        report = optimize(
            loss,
            optimizer,
            Schedule(40, end=0.1),
            stage="test",
            report=received.append,
            checkpointing=Checkpointing(path, -1.0),
            extra_state=seen,
        )
        assert report.steps == 40 and len(report.curves["far"]) == 40
        assert sum(len(p.scalars["far"]) for p in received) == 40, "observers receive all steps, after a resume too"
        return x.detach(), seen.steps, report.curves["far"]

    torch.manual_seed(0)
    whole = run(None, tmp_path / "a.npz", torch.zeros(3))
    torch.manual_seed(0)
    with pytest.raises(KeyboardInterrupt):
        run(17, tmp_path / "b.npz", torch.zeros(3))
    # the initial values of the second call do not matter, nor does its random seed: it resumes from the checkpoint
    torch.manual_seed(5)
    resumed = run(None, tmp_path / "b.npz", torch.full((3,), 9.0))
    assert torch.equal(resumed[0], whole[0]) and resumed[1] == whole[1] == list(range(40))
    assert np.array_equal(resumed[2], whole[2])
    # a finished loop is not run again
    again = run(3, tmp_path / "b.npz", torch.zeros(3))
    assert torch.equal(again[0], whole[0]) and again[1] == whole[1]


class Seen:
    """State that a loop changes besides its parameters."""

    def __init__(self) -> None:
        self.steps: list[int] = []

    def state(self) -> dict[str, np.ndarray]:
        return {"steps": np.array(self.steps)}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        self.steps = state["steps"].tolist()


def test_a_short_loop_leaves_no_checkpoint(tmp_path: Path) -> None:
    x, optimizer = _line(1.0)
    optimize(
        lambda _: {"far": x.square().sum()},
        optimizer,
        Schedule(5),
        stage="test",
        checkpointing=Checkpointing(tmp_path / "a.npz"),
    )
    assert not list(tmp_path.iterdir())


def test_a_checkpoint_of_other_shapes_or_damaged_is_ignored(tmp_path: Path) -> None:
    x, optimizer = _line(1.0)
    path = tmp_path / "state.npz"
    assert load_checkpoint(path, optimizer) is None
    save_checkpoint(path, torch.optim.Adam([torch.zeros(7, requires_grad=True)], 0.1), 12)
    assert load_checkpoint(path, optimizer) is None and x.item() == 1.0
    whole = path.read_bytes()
    for damaged in (b"half a file", b"", whole[:100], whole[:-40], whole[:200] + b"\xff" * 50 + whole[250:]):
        path.write_bytes(damaged)
        assert load_checkpoint(path, optimizer) is None and x.item() == 1.0


def test_observers_receive_groups_of_steps_that_add_up_to_all_steps() -> None:
    x, optimizer = _line(3.0)
    received: list[Progress] = []
    optimize(
        lambda _: {"far": x.square().sum()},
        optimizer,
        Schedule(500),
        stage="test",
        report=received.append,
        first_step=100,
        total_steps=1000,
    )
    assert sum(len(p.scalars["loss"]) for p in received) == 500
    assert received[-1].step == 600 and received[-1].steps == 1000
    # four a second at most, and one at the end
    assert len(received) <= received[-1].seconds / 0.25 + 1


def test_large_steps_solve_their_own_equation() -> None:
    positions, faces = bumpy_sphere(3)
    mesh = mesh_of(positions, faces)
    large = LargeSteps(mesh.topology, len(positions), 19.0)
    u = large.encode(mesh.positions).requires_grad_(True)
    x = large.decode(u)
    assert float((x - mesh.positions).detach().abs().max()) < 1e-5
    weight = torch.randn(x.shape, generator=torch.Generator().manual_seed(1))
    (x * weight).sum().backward()
    # the matrix is symmetric: (I + λL) applied to the gradient gives the weight back
    assert float((large.encode(u.grad) - weight).abs().max()) < 1e-4


def test_uniform_adam_keeps_the_direction_of_a_first_step() -> None:
    x = torch.zeros(4, 3, requires_grad=True)
    x.grad = torch.tensor(np.random.default_rng(0).normal(size=(4, 3))).float()
    UniformAdam([x], 0.5).step()
    assert x.detach() == pytest.approx(-0.5 * x.grad / x.grad.abs().max(), abs=1e-6)
    y = torch.ones(2, requires_grad=True)
    y.grad = torch.zeros(2)
    UniformAdam([y], 0.5).step()
    assert y.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("size", [1e-30, 1e-25, 1e22, 1e30])
def test_uniform_adam_takes_a_step_of_its_rate_whatever_the_size_of_the_gradient(size: float) -> None:
    x = torch.zeros(1, requires_grad=True)
    x.grad = torch.full((1,), size)  # its square underflows or overflows in float32
    UniformAdam([x], 0.5).step()
    assert x.item() == pytest.approx(-0.5, rel=1e-5)


def test_the_caller_may_end_a_loop() -> None:
    x, optimizer = _line(3.0)
    report = optimize(
        lambda _: {"far": (x - 1).square().sum()}, optimizer, Schedule(50), stage="test", after_step=lambda s: s == 6
    )
    assert report.stopped_early and report.steps == 7 and len(report.curves["far"]) == 7


def test_of_many_nonfinite_steps_the_first_are_described_and_all_counted() -> None:
    x, optimizer = _line(3.0)

    def loss(step: int) -> dict[str, torch.Tensor]:
        return {"far": (x - 1).square().sum() * (float("nan") if step % 2 else 1.0)}

    report = optimize(loss, optimizer, Schedule(100), stage="test", locate=lambda step, term: f"vertex {step}")
    assert report.skipped == {"far": 50} and len(report.diagnostics) == MAX_CONSECUTIVE_NONFINITE_STEPS
    assert report.diagnostics[0] == "step 1: far is not finite at vertex 1"


def test_no_terms_are_a_loss_of_zero() -> None:
    x, optimizer = _line(3.0)
    report = optimize(lambda _: {}, optimizer, Schedule(3), stage="test")
    assert report.curves["loss"].tolist() == [0.0] * 3 and x.item() == 3.0


def test_a_loop_can_stop_at_the_first_nonfinite_step() -> None:
    x, optimizer = _line(3.0)

    def loss(step: int) -> dict[str, torch.Tensor]:
        return {"far": (x - 1).square().sum() * (float("nan") if step == 4 else 1.0)}

    report = optimize(loss, optimizer, Schedule(50), stage="test", stop_at_nonfinite=True)
    assert report.stopped_early and report.steps == 5 and report.skipped == {"far": 1}


def test_gradients_may_be_changed_before_the_step() -> None:
    x, optimizer = _line(3.0)

    def freeze(step: int) -> None:
        if step < 10:
            x.grad = None

    optimize(lambda _: {"far": (x - 1).square().sum()}, optimizer, Schedule(10), stage="test", after_backward=freeze)
    assert x.item() == 3.0


def test_checkpoints_are_only_stored_at_multiples(tmp_path: Path) -> None:
    x, optimizer = _line(3.0)
    path = tmp_path / "a.npz"

    def loss(step: int) -> dict[str, torch.Tensor]:
        if step == 13:
            raise KeyboardInterrupt
        return {"far": (x - 1).square().sum()}

    with pytest.raises(KeyboardInterrupt):
        optimize(loss, optimizer, Schedule(50), stage="test", checkpointing=Checkpointing(path, -1.0, every_steps=5))
    checkpoint = load_checkpoint(path, optimizer)
    assert checkpoint is not None and checkpoint[0] == 10
