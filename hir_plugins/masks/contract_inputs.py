"""Inputs for the contract tests of mask sources (`Component.testing`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray

from hir_core.capture import Capture

if TYPE_CHECKING:
    from hir_core.testing.captures import TinyCapture


def photographs_with_alpha(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """The photographs with their coverage, as if they had an alpha channel."""
    del capture, folder
    return truth.capture, {}


def folder_of_masks(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """Masks as image files in a folder of the capture."""
    del folder
    for view, mask in zip(capture.views, truth.masks, strict=True):
        write_png(truth.folder / "cut_out" / f"{view.name}.png", mask[..., None].repeat(3, axis=2))
    return capture, {"path": "cut_out"}


def photographs_with_weights(truth: TinyCapture, capture: Capture, folder: Path) -> tuple[Capture, dict[str, object]]:
    """The photographs, and a network that compares each pixel with the background's colour; needs `onnx`."""
    del folder
    weights = truth.folder / "weights.onnx"
    write_background_network(weights, capture.views[0].pixels().color_linear[0, 0])
    return capture, {"weights": weights.name}


def write_background_network(path: Path, background_linear: NDArray[np.float32]) -> None:
    """A network with U²-Net's input and output (1×3×320×320 → 1×1×320×320): 1 where the colour differs from a key."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    # rembg divides images by their maximum, then normalises them with the statistics of U²-Net's training set
    mean, deviation = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    key = ((linear_to_srgb(background_linear.astype(np.float64)) - mean) / deviation).astype(np.float32)
    constants = {"key": key.reshape(1, 3, 1, 1), "least": np.array(0.5, np.float32), "axes": np.array([1], np.int64)}
    nodes = [
        helper.make_node("Sub", ["picture", "key"], ["difference"]),
        helper.make_node("Abs", ["difference"], ["distance"]),
        helper.make_node("ReduceSum", ["distance", "axes"], ["total"], keepdims=1),
        helper.make_node("Greater", ["total", "least"], ["in_front"]),
        helper.make_node("Cast", ["in_front"], ["mask"], to=TensorProto.FLOAT),
    ]
    graph = helper.make_graph(
        nodes,
        "background",
        [helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, 320, 320])],
        [helper.make_tensor_value_info("mask", TensorProto.FLOAT, [1, 1, 320, 320])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    path.write_bytes(model.SerializeToString())
    onnx.checker.check_model(str(path))
