"""Nothing mixes tensors of the processor and of a CUDA device: seen on every machine, with a pretended device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
import torch

from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.pipeline import reconstruct
from hir_core.plugins.manager import PluginManager
from hir_core.run.run_directory import RunDirectory
from hir_core.testing import check_component
from hir_core.testing.checks.probing import ON_DEVICES
from tests.fixtures.command_line import hir
from tests.fixtures.pretended_cuda import OnCuda, PretendedCuda, pretended_cuda
from tests.fixtures.runs import QUICK

PLUGINS = PluginManager.discover()
STOCHASTIC = "mitsuba_ggx"
"""Its noise differs between devices; test_cuda.py compares means."""
COMPONENTS = [r.component.name for r in PLUGINS.components() if r.distribution == "hir" and r.kind in ON_DEVICES]
SLOW = {"transport_ggx": [pytest.mark.slow]}
RUNS = {
    "defaults": (),
    "soft_silhouette": ("geometry.renderer=soft_silhouette",),
    "all_hypotheses": ("reflectance.model=auto", "reflectance.light_frame=auto"),
    "camera_light": ("reflectance.model=specular_map", "reflectance.light_frame=camera"),
    "normal_map": ("reflectance.model=normal_map",),
    "roughness_map": ("reflectance.model=roughness_map",),
    "gradients": ("reflectance.renderer=mitsuba_ggx", "reflectance.gradient.iterations=10"),
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=SLOW.get(n, [])) for n in COMPONENTS if n != STOCHASTIC])
def test_component_keeps_to_the_device_of_its_input(name: str) -> None:
    with pretended_cuda():
        (*_, result) = check_component(name, only=["devices_agree"], plugins=PLUGINS)
    assert result.outcome == "passed"


@pytest.mark.slow
def test_stereo_has_the_device_of_the_run(tiny_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also on a machine with a CUDA device that the user does not want."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assignments = (*QUICK, 'initializers=["visual_hull", "stereo"]')
    run = reconstruct(tiny_capture, tmp_path, assignments=assignments, device="cpu", until="initializer")
    details = RunDirectory(run.path).read_run()["stages"]["initializer"]["report"]["details"]
    assert details["stereo"]["method"] == "surface sweep in torch on cpu"


@pytest.mark.slow
def test_commands_keep_to_the_device_of_the_run(tiny_capture: Path, tmp_path: Path) -> None:
    """Commands without an option for the device use that of the run."""
    run, light = tmp_path / "run", tiny_capture / "env_relight_0.hdr"
    with pretended_cuda():
        reconstruct(tiny_capture, run, assignments=QUICK, device="cuda")
        for command in (
            ("evaluate", run, "--split", "relight_0"),
            ("render", run, "--orbit", 1, "--size", 32, "--relight", light, "-o", tmp_path / "pictures"),
            ("render", run, "--view", "003", "-o", tmp_path / "view"),
            ("export", run, "-f", "glb", "-o", tmp_path / "exports"),
            ("report", run),
        ):
            assert hir(*command) == 0, command


@pytest.mark.slow
@pytest.mark.parametrize("case", RUNS)
def test_run_keeps_to_its_device(case: str, tiny_capture: Path, tmp_path: Path) -> None:
    """With the default settings it also gives what the processor gives, because it computes the same."""
    quick = [text for text in QUICK if case != "gradients" or not text.startswith("reflectance_renderer.transport_ggx")]
    runs = ("cuda", "cpu") if case == "defaults" else ("cuda",)
    for device in runs:
        with pretended_cuda() if device == "cuda" else nullcontext():
            assignments = (*quick, *RUNS[case])
            reconstruct(tiny_capture, tmp_path / device, assignments=assignments, device=device, deterministic=True)
    psnr = [evaluate_run(RunDirectory(tmp_path / device), EvaluationRequest(), PLUGINS)["psnr"] for device in runs]
    assert all(found["object"] == pytest.approx(psnr[-1]["object"], abs=0.01) for found in psnr)


class TestPretendedDevice:
    """It finds what PyTorch refuses on a real device, and nothing else."""

    @pytest.fixture(autouse=True)
    def device(self) -> Iterator[None]:
        with PretendedCuda():
            yield

    def test_results_stay_on_the_device(self) -> None:
        a = torch.ones(3, 4, device="cuda")
        index = torch.arange(2).to("cuda")
        for value in (a + 1, a * torch.tensor(2.0), a[index], a[torch.arange(2)], torch.zeros_like(a), a.double(), a.T):
            assert value.is_cuda and value.device == torch.device("cuda:0")
        assert not a.cpu().is_cuda and a.cpu().numpy().sum() == 12

    def test_derivatives_are_on_the_device(self) -> None:
        x = torch.ones(3, device="cuda").requires_grad_()
        (gradient,) = torch.autograd.grad((x * x).sum(), x)
        assert isinstance(gradient, OnCuda) and gradient.tolist() == [2, 2, 2]

    def test_two_devices_are_refused(self) -> None:
        a, b = torch.ones(3, device="cuda"), torch.ones(3)
        with pytest.raises(RuntimeError, match="expected all tensors to be on the same device"):
            a + b
        with pytest.raises(RuntimeError, match="expected all tensors to be on the same device"):
            b[torch.zeros(1, dtype=torch.long, device="cuda")]
        with pytest.raises(TypeError, match=r"use Tensor\.cpu"):
            a.numpy()
