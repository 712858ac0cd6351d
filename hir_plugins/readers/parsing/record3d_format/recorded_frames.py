"""Photograph and depth of one frame of a recording, read on demand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import DepthPixels, MeasuredDepth, Pixels
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.decoding.photo_file import linear_pixels, read_mask
from hir_plugins.readers.parsing.decoding.picture_decoding import decode_picture
from hir_plugins.readers.parsing.depth_file import confidence_shares
from hir_plugins.readers.parsing.record3d_format.lzfse_blocks import decompress, measured_blocks
from hir_plugins.readers.parsing.record3d_format.metadata import MAX_DEPTH_PIXELS, RecordingMetadata
from hir_plugins.readers.parsing.record3d_format.recording_files import RecordingFile


@dataclass(frozen=True)
class RecordedPhoto:
    """Reads a photograph, and its mask file, when called; picklable, without pixels in memory."""

    file: RecordingFile
    width: int
    height: int
    mask_path: Path | None = None

    def __call__(self) -> Pixels:
        encoded = decode_picture(self.file.read(), self.file.name)
        height, width = encoded.shape[:2]
        if (width, height) != (self.width, self.height):
            raise CaptureError(f"{self.file.name} is {width}×{height}, the first photograph {self.width}×{self.height}")
        color, saturated = linear_pixels(encoded)
        mask = None if self.mask_path is None else read_mask(self.mask_path, width, height)
        return Pixels(color, mask, saturated)


@dataclass(frozen=True)
class RecordedDepth:
    """Reads a depth map, and its confidences, when called; picklable, without pixels in memory."""

    depth: RecordingFile
    confidence: RecordingFile | None
    size: tuple[int, int] | None
    """Width and height; None where the metadata does not say them."""
    aspect: float
    """Width over height of the photograph."""

    def __call__(self) -> DepthPixels:
        content = self.depth.read()
        width, height = self.size or self._size(content)
        metres = np.frombuffer(_decompressed(self.depth, content, width * height * 4), "<f4").reshape(height, width)
        known = np.isfinite(metres) & (metres > 0)
        depth = np.where(known, metres, 0).astype(np.float32)
        if self.confidence is None:
            return DepthPixels(depth, known.astype(np.float32))
        content = self.confidence.read()
        levels = np.frombuffer(_decompressed(self.confidence, content, width * height), np.uint8)
        shares: NDArray[np.float32] = confidence_shares(levels.reshape(height, width))
        return DepthPixels(depth, np.where(known, shares, np.float32(0)))

    def _size(self, content: bytes) -> tuple[int, int]:
        """From the number of pixels: depth maps have the aspect ratio of the photographs."""
        try:
            pixels = measured_blocks(content)[0] / 4
        except ValueError as error:
            raise CaptureError(f"{self.depth.name} is damaged ({error}); export the recording again") from None
        width = round(math.sqrt(pixels * self.aspect))
        height = round(pixels / width) if width else 0
        if not 0 < width * height == pixels <= MAX_DEPTH_PIXELS:
            raise CaptureError(f"{self.depth.name}: {pixels:g} depths fill no map with the photograph's aspect ratio")
        return width, height


def recorded_depth(
    depth: RecordingFile, confidence: RecordingFile | None, metadata: RecordingMetadata
) -> MeasuredDepth:
    """The depth of a frame, in metres; the files are opened when it is asked for."""
    aspect = metadata.width / metadata.height
    paths = (depth.path,) if confidence is None else (depth.path, confidence.path)
    return MeasuredDepth(RecordedDepth(depth, confidence, metadata.depth_size, aspect), paths=paths)


def _decompressed(file: RecordingFile, content: bytes, length: int) -> bytes:
    try:
        return decompress(content, length)
    except ValueError as error:
        raise CaptureError(f"{file.name} is damaged ({error}); export the recording again") from None
