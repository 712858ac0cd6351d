"""Masks by a network: the real runtime, on a network that the test makes."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_plugins.masks.contract_inputs import write_background_network
from hir_plugins.masks.options import RembgOptions
from hir_plugins.masks.rembg import Rembg
from tests.fixtures.silhouette_captures import dome, make_view

pytestmark = pytest.mark.skipif(  # not importorskip: importing rembg would change the threads of all other tests
    find_spec("rembg") is None or find_spec("onnx") is None, reason="rembg or onnx is missing: pip install 'hir[rembg]'"
)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A disc of 0.6 on a background of 0.1, and a picture of one colour."""
    folder = tmp_path_factory.mktemp("photographs")
    camera = dome(1, 3.0, np.zeros(3), 100.0, 80)[0]
    rows, columns = np.mgrid[0:80, 0:80] + 0.5
    disc = np.hypot(rows - 40, columns - 34) < 20
    picture = np.where(disc[..., None], 0.6, 0.1).astype(np.float32).repeat(3, axis=2)
    # rembg divides by the brightest value: one pixel at white keeps the others as they are
    picture[0, 0] = 1.0
    write_background_network(folder / "weights.onnx", np.full(3, 0.1, np.float32))
    views = (
        make_view("disc", camera, disc.astype(np.float32), picture),
        make_view("flat", camera, disc.astype(np.float32), np.full((80, 80, 3), 0.1, np.float32)),
    )
    return Capture(folder, views)


def test_what_stands_in_front_is_found(photographs: Capture) -> None:
    disc, flat = Rembg(RembgOptions(weights="weights.onnx")).masks(photographs, None)
    assert disc is not None and flat is not None and disc.dtype == np.float32
    true = photographs.views[0].pixels().mask
    assert true is not None
    assert np.minimum(disc, true)[1:].sum() / np.maximum(disc, true)[1:].sum() > 0.9
    assert not flat.any()


def test_nothing_is_downloaded(photographs: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("U2NET_HOME", str(tmp_path))
    with pytest.raises(CaptureError, match="rembg d u2net"):
        Rembg(RembgOptions()).masks(photographs, None)
    assert not list(tmp_path.rglob("*.onnx"))


def test_what_is_no_network_is_named(photographs: Capture) -> None:
    with pytest.raises(CaptureError, match="has no model 'magic'"):
        Rembg(RembgOptions(model="magic")).masks(photographs, None)
    with pytest.raises(CaptureError, match="does not exist"):
        Rembg(RembgOptions(weights="none.onnx")).masks(photographs, None)
    (photographs.path / "broken.onnx").write_bytes(b"not a network")
    with pytest.raises(CaptureError, match="not a network"):
        Rembg(RembgOptions(weights="broken.onnx")).masks(photographs, None)


@pytest.mark.slow
def test_the_number_of_threads_stays(photographs: Capture) -> None:
    """rembg imports numba, which sets OpenMP's threads to the number of cores, also those of torch."""
    program = f"""
import torch
from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_plugins.masks.options import RembgOptions
from hir_plugins.masks.rembg import Rembg
from tests.fixtures.silhouette_captures import dome, make_view
import numpy as np, pathlib, sys
camera = dome(1, 3.0, np.zeros(3), 100.0, 80)[0]
view = make_view("disc", camera, np.ones((80, 80), np.float32), np.full((80, 80, 3), 0.5, np.float32))
Rembg(RembgOptions(weights="weights.onnx")).masks(Capture(pathlib.Path({str(photographs.path)!r}), (view,)), None)
assert "numba" in sys.modules
print(torch.get_num_threads())
"""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "2"}
    command = [sys.executable, "-W", "ignore", "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "1"
