"""Iterations of GrabCut against the masks that a capture of photographs has.

    python -m benchmarks.grabcut_masks CAPTURE --iterations 1 2 4
    python -m benchmarks.grabcut_masks --table benchmarks/results/grabcut_masks.jsonl

The capture has masks and cameras. Its points are triangulated by the initializer `colmap` without the masks, which then
only judge the masks that GrabCut makes. A capture that is solved already in `--workspace` is not solved again.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.stored_rows import add_rows, parsed, provenance
from hir_core.capture import Capture, Pixels
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.interfaces import Initializer, MaskSource
from hir_core.plugins.manager import PluginManager

STORE = Path("benchmarks/results/grabcut_masks.jsonl")


@dataclass(frozen=True)
class WithoutMask:
    """Reads a photograph without its mask."""

    read: Callable[[], Pixels]

    def __call__(self) -> Pixels:
        return replace(self.read(), mask=None)


def unmasked(capture: Capture) -> Capture:
    """The capture without its masks."""
    views = (replace(view, read=WithoutMask(view.read), mask=None, mask_path=None) for view in capture.views)
    return replace(capture, views=tuple(views))


def overlap(found: NDArray[np.float32], true: NDArray[np.float32]) -> float:
    """Intersection over union of two masks."""
    first, second = found > 0.5, true > 0.5
    return float((first & second).sum() / max((first | second).sum(), 1))


def measured(path: Path, iterations: Sequence[int], workspace: Path) -> list[dict[str, Any]]:
    """A row for each number of iterations."""
    plugins = PluginManager.discover()
    capture = read_capture(path, "train", plugins)
    true = [view.pixels().mask for view in capture.views]
    colmap: Initializer = plugins.create("initializer", "colmap", None)
    solved, _ = colmap.initialize(unmasked(capture), None, workspace)
    rows = []
    for count in iterations:
        grabcut: MaskSource = plugins.create("mask_source", "grabcut", {"iterations": count})
        before = time.process_time()
        masks = grabcut.masks(solved, None)
        seconds = time.process_time() - before
        overlaps = [
            overlap(found, mask)
            for found, mask in zip(masks, true, strict=True)
            if found is not None and mask is not None
        ]
        rows.append(
            {
                "capture": path.name,
                "iterations": count,
                "views": len(overlaps),
                "processor_seconds": round(seconds, 1),
                "mean_iou": round(float(np.mean(overlaps)), 4),
                "lowest_iou": round(min(overlaps), 4),
            }
            | provenance()
        )
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Overlap and time by the number of iterations."""
    lines = ["| capture | iterations | mean IoU | lowest IoU | processor seconds |", "|---|---|---|---|---|"]
    lines += [
        f"| {row['capture']} | {row['iterations']} | {row['mean_iou']:.4f} | {row['lowest_iou']:.3f} "
        f"| {row['processor_seconds']:.0f} |"
        for row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    """Measures and stores, or prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", nargs="?", type=Path)
    parser.add_argument("--iterations", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--workspace", type=Path, help="folder of the solved cameras and points")
    parser.add_argument("--store", type=Path, default=STORE, help="file of stored lines")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parsed(parser, table)
    if options.capture is None:
        parser.error("name a capture, or --table")
    with tempfile.TemporaryDirectory() as temporary:
        workspace = options.workspace or Path(temporary)
        workspace.mkdir(parents=True, exist_ok=True)
        add_rows(options.store, measured(options.capture, options.iterations, workspace))


if __name__ == "__main__":
    main()
