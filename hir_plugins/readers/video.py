"""A video walked around the object: its sharpest frames, well spread over time."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from hir_exporters.conventions import srgb_to_linear
from numpy.typing import NDArray

from hir_core.capture import Capture, Pixels, View
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.photo_file import SATURATED_LEVEL

VIDEO_SUFFIXES: Final = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")

FRAMES: Final = 80
"""Frames that are taken: one from each of as many equal parts of the video."""

_COMPARISON_SIDE_PIXELS = 480
"""Longer side at which frames are compared for sharpness."""


@final
class VideoReader(CaptureReader):
    """Takes the sharpest frame of each of 80 equal parts of a video; the world is for others to find."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A video file, or a folder that holds one and no photographs."""
        from hir_plugins.readers.photos import PhotosReader

        return _video(path) is not None and (path.is_file() or not PhotosReader(NoOptions()).matches(path))

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """The frames' times and names; decodes the video once. One that cannot be decoded is a `CaptureError`."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; a video has only 'train'")
        video = _video(path)
        if video is None:
            raise CaptureError(f"{path} holds no single video ({', '.join(VIDEO_SUFFIXES)})")
        sharp = sharpness(video)
        if len(sharp) < 3:
            raise CaptureError(f"{video} has {len(sharp)} frames; walk around the object for half a minute")
        chosen = sharpest_in_intervals(np.array([value for _, value in sharp]), FRAMES)
        if len(chosen) < 20:
            advice = f"{video.name} gives only {len(chosen)} frames; 30 to 80 from all sides are better"
            warnings.warn(advice, stacklevel=2)
        frames = tuple(
            View(f"{number:05d}", None, VideoFrame(video, sharp[number][0]), path=video) for number in chosen
        )
        return Capture(path=path, views=frames, reader="video")


@dataclass(frozen=True)
class VideoFrame:
    """Reads one frame when called; picklable, holds no pixels."""

    path: Path
    time: int
    """Presentation time in the stream's own unit."""

    def __call__(self) -> Pixels:
        with _open_video(self.path) as container:
            stream = container.streams.video[0]
            try:
                container.seek(self.time, stream=stream)
                for frame in container.decode(stream):
                    if frame.pts is not None and frame.pts >= self.time:
                        return _pixels(_upright(frame, "rgb24"))
            except Exception as error:  # PyAV's own types, some of which call themselves a lack of permission
                raise CaptureError(f"{self.path} breaks at {self.time} ({' '.join(str(error).split())})") from None
        raise CaptureError(f"{self.path} has no frame at {self.time} any more; was it changed?")


def sharpness(video: Path) -> list[tuple[int, float]]:
    """Time and sharpness of every frame: the variance of the Laplacian of its brightness, made small."""
    found = []
    with _open_video(video) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        try:
            for frame in container.decode(stream):
                if frame.pts is None:
                    continue
                step = max(1, max(frame.width, frame.height) // _COMPARISON_SIDE_PIXELS)
                image = frame.to_ndarray(format="gray").astype(np.float32)
                height, width = image.shape[0] // step * step, image.shape[1] // step * step
                small = image[:height, :width].reshape(height // step, step, width // step, step).mean(axis=(1, 3))
                bend = 4 * small[1:-1, 1:-1] - small[:-2, 1:-1] - small[2:, 1:-1] - small[1:-1, :-2] - small[1:-1, 2:]
                found.append((int(frame.pts), float(bend.var()) if bend.size else 0.0))
        except Exception as error:  # a truncated file: what came before the break is good
            if not found:
                raise CaptureError(f"{video} cannot be decoded ({' '.join(str(error).split())})") from None
            warnings.warn(f"{video.name} breaks off after {len(found)} frames", stacklevel=2)
    return found


def sharpest_in_intervals(sharp: NDArray[np.floating], count: int) -> list[int]:
    """The index of the sharpest of each of `count` equal parts; all where there are no more."""
    if len(sharp) <= count:
        return list(range(len(sharp)))
    edges = np.linspace(0, len(sharp), count + 1).round().astype(int)
    return [int(low + np.argmax(sharp[low:high])) for low, high in pairwise(edges)]


def _video(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() in VIDEO_SUFFIXES else None
    found = [p for p in sorted(path.glob("*")) if p.suffix.lower() in VIDEO_SUFFIXES and p.is_file()]
    if len(found) != 1:
        return None
    return found[0] if found[0].resolve().is_relative_to(path.resolve()) else None


_SELF_CONTAINED = {
    "protocol_whitelist": "file",
    "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,ogg,flv,asf",
}
"""Containers that hold their pictures: a playlist, whatever its ending, would open other files and addresses."""


def _open_video(path: Path) -> Any:
    try:
        import av
    except ImportError:
        raise ConfigError(
            f"{path} is a video; install its reader with: pip install av, or save its frames as photographs"
        ) from None
    try:
        container = av.open(str(path), options=_SELF_CONTAINED)
    except Exception as error:  # PyAV raises its own types for each way a file can be broken
        raise CaptureError(f"{path} cannot be opened as a video ({' '.join(str(error).split())})") from None
    if not container.streams.video:
        container.close()
        raise CaptureError(f"{path} holds no picture, only sound")
    return container


def _upright(frame: Any, form: str) -> NDArray[np.uint8]:
    """The frame as it is meant to be seen: phones write how they were held beside the picture."""
    pixels = frame.to_ndarray(format=form)
    # degrees counter-clockwise by which the picture is to be turned
    return np.ascontiguousarray(np.rot90(pixels, round(getattr(frame, "rotation", 0) / 90) % 4))


def _pixels(encoded: NDArray[np.uint8]) -> Pixels:
    linear = srgb_to_linear(np.arange(256) / 255).astype(np.float32)[encoded]
    return Pixels(linear, None, (encoded >= np.ceil(SATURATED_LEVEL * 255)).any(axis=2))
