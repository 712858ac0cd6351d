"""A video around the object: the sharpest frame of each of 80 equal parts."""

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
from hir_plugins.readers.parsing.decoding.photo_file import SATURATED_LEVEL

VIDEO_SUFFIXES: Final = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")

FRAMES: Final = 80
"""Number of equal parts of the video; one frame is taken from each."""

_COMPARISON_SIDE_PIXELS = 480
"""Longer side at which the sharpness of frames is measured."""


@final
class VideoReader(CaptureReader):
    """Takes the sharpest frame of each of 80 equal parts of a video; an initializer estimates their cameras."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A video file, or a folder with one video and no photographs."""
        from hir_plugins.readers.photos import PhotosReader

        return _video(path) is not None and (path.is_file() or not PhotosReader(NoOptions()).matches(path))

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Views of the selected frames; the video is decoded once. An undecodable video raises `CaptureError`."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of a video")
        video = _video(path)
        if video is None:
            raise CaptureError(f"{path} has no video or several ({', '.join(VIDEO_SUFFIXES)}); give one video file")
        timed = sharpness(video)
        if len(timed) < 3:
            raise CaptureError(f"{video} has {len(timed)} frames; record half a minute around the object")
        selected = sharpest_in_intervals(np.array([value for _, value in timed]), FRAMES)
        if len(selected) < 20:
            advice = f"{video.name} gives only {len(selected)} frames; 30 to 80 from all sides are better"
            warnings.warn(advice, stacklevel=2)
        frames = tuple(
            View(f"{number:05d}", None, VideoFrame(video, timed[number][0]), path=video) for number in selected
        )
        return Capture(path=path, views=frames, reader="video")


@dataclass(frozen=True)
class VideoFrame:
    """Reads one frame when called; picklable, without pixels in memory."""

    path: Path
    time: int
    """Presentation time in the video stream's time base."""

    def __call__(self) -> Pixels:
        with _open_video(self.path) as container:
            stream = container.streams.video[0]
            try:
                container.seek(self.time, stream=stream)
                for frame in container.decode(stream):
                    if frame.pts is not None and frame.pts >= self.time:
                        return _pixels(_upright(frame, "rgb24"))
            except Exception as error:  # PyAV's own types; some derive from PermissionError
                raise CaptureError(
                    f"{self.path} cannot be decoded at {self.time} ({' '.join(str(error).split())}); export it again"
                ) from None
        raise CaptureError(f"{self.path} has no frame at {self.time}: the file has changed; read the capture again")


def sharpness(video: Path) -> list[tuple[int, float]]:
    """Time and sharpness of every frame: the variance of the Laplacian of its reduced brightness."""
    measured = []
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
                measured.append((int(frame.pts), laplacian_variance(small)))
        except Exception as error:  # a truncated file: the frames before the damage are usable
            if not measured:
                raise CaptureError(
                    f"{video} cannot be decoded ({' '.join(str(error).split())}); export it again"
                ) from None
            warnings.warn(f"{video.name} cannot be decoded after {len(measured)} frames", stacklevel=2)
    return measured


def laplacian_variance(gray: NDArray[np.float32]) -> float:
    """Variance of the Laplacian of a grey image (H, W): larger where it is sharper."""
    center, rows = gray[1:-1, 1:-1], (gray[:-2, 1:-1], gray[2:, 1:-1])
    laplacian = 4 * center - rows[0] - rows[1] - gray[1:-1, :-2] - gray[1:-1, 2:]
    return float(laplacian.var()) if laplacian.size else 0.0


def sharpest_in_intervals(sharp: NDArray[np.floating], count: int) -> list[int]:
    """Indices of the sharpest frame of each of `count` equal parts; all frames if there are at most `count`."""
    if len(sharp) <= count:
        return list(range(len(sharp)))
    edges = np.linspace(0, len(sharp), count + 1).round().astype(int)
    return [int(low + np.argmax(sharp[low:high])) for low, high in pairwise(edges)]


def _video(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() in VIDEO_SUFFIXES else None
    videos = [p for p in sorted(path.glob("*")) if p.suffix.lower() in VIDEO_SUFFIXES and p.is_file()]
    if len(videos) != 1:
        return None
    return videos[0] if videos[0].resolve().is_relative_to(path.resolve()) else None


_SELF_CONTAINED = {
    "protocol_whitelist": "file",
    "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,ogg,flv,asf",
}
"""Container formats with embedded frames: playlists, whatever their suffix, would open other files and addresses."""


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
        raise CaptureError(
            f"{path} cannot be opened as a video ({' '.join(str(error).split())}); export it as .mp4"
        ) from None
    if not container.streams.video:
        container.close()
        raise CaptureError(f"{path} has no video stream; give a file with video")
    return container


def _upright(frame: Any, form: str) -> NDArray[np.uint8]:
    """The frame in display orientation: phones store the rotation as metadata."""
    pixels = frame.to_ndarray(format=form)
    # `rotation` is in degrees counter-clockwise
    return np.ascontiguousarray(np.rot90(pixels, round(getattr(frame, "rotation", 0) / 90) % 4))


def _pixels(encoded: NDArray[np.uint8]) -> Pixels:
    linear = srgb_to_linear(np.arange(256) / 255).astype(np.float32)[encoded]
    return Pixels(linear, None, (encoded >= np.ceil(SATURATED_LEVEL * 255)).any(axis=2))
