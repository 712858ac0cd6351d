"""Mask source: a segmentation network (rembg), with weights that are already on this machine."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.options import RembgOptions

if TYPE_CHECKING:
    from hir_core.scene import Scene


@final
class Rembg(MaskSource):
    """Segments each photograph alone; antialiased edges are preserved. Nothing is downloaded."""

    def __init__(self, config: RembgOptions) -> None:
        self._config = config

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask for each view. Missing weights raise `CaptureError`."""
        del scene
        if not capture.views:
            return []
        with _numba_imported_quietly():
            session = _session(self._config, capture)
        return [_mask(view.pixels().color_linear, session) for view in capture.views]


@contextlib.contextmanager
def _numba_imported_quietly() -> Iterator[None]:
    """Restores torch's number of threads after the block, and ignores numba's warning of an older TBB (open3d's).

    rembg imports numba, which sets the OpenMP threads of the whole process to the number of cores. A task of a batch,
    or a run under OMP_NUM_THREADS, would then use more threads than it may for all that follows.
    """
    torch = sys.modules.get("torch")
    count = torch.get_num_threads() if torch is not None else None
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*The TBB threading layer")
            yield
    finally:
        if torch is not None:
            torch.set_num_threads(count)


def _session(options: RembgOptions, capture: Capture) -> Any:
    from rembg import new_session
    from rembg.sessions import sessions_class

    if options.weights:
        path = Path(options.weights)
        path = path if path.is_absolute() else capture.path / path
        if not path.is_file():
            raise CaptureError(f"{path} does not exist; set mask_source.rembg.weights to an ONNX file")
        return _open_network(path, lambda: _session_of_file(path))
    known = {kind.name(): kind for kind in sessions_class}
    if options.model not in known:
        raise CaptureError(f"rembg has no model {options.model!r}; use one of: {', '.join(sorted(known))}")
    kind = known[options.model]
    predicted = kind.resolve_existing(f"{options.model}.onnx")
    if predicted is None:
        raise CaptureError(
            f"the weights of {options.model} are not on this machine, and hir does not download them; download them "
            "once "
            f"with: rembg d {options.model}"
        )
    return _open_network(Path(predicted), lambda: new_session(options.model))


def _session_of_file(weights: Path) -> Any:
    """rembg's U²-Net with weights from any file: rembg itself opens only files in its own folder."""
    from onnxruntime import SessionOptions
    from rembg.sessions.u2net import U2netSession

    class LocalWeightsSession(U2netSession):  # type: ignore[misc]
        @classmethod
        def download_models(cls, *args: Any, **kwargs: Any) -> str:
            return str(weights)

    return LocalWeightsSession("local", SessionOptions())


def _open_network(path: Path, make: Callable[[], Any]) -> Any:
    try:
        return make()
    except Exception as error:  # the runtime raises types of its own on a broken file
        raise CaptureError(
            f"{path} is not a network that rembg can run ({' '.join(str(error).split())[:200]}); download it again"
        ) from error


def _mask(color_linear: NDArray[np.float32], session: Any) -> NDArray[np.float32]:
    from PIL import Image
    from rembg import remove

    encoded = np.rint(np.clip(linear_to_srgb(np.clip(color_linear, 0, 1)), 0, 1) * 255).astype(np.uint8)
    if not np.ptp(encoded):
        # an image of one colour has no foreground, and normalising it would divide by zero
        return np.zeros(encoded.shape[:2], np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        predicted = np.asarray(remove(Image.fromarray(encoded), session=session, only_mask=True), dtype=np.float32)
    return np.nan_to_num(predicted.reshape(encoded.shape[:2]) / 255)
