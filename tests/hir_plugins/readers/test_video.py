"""Frames of a video: sharp, distributed over time, at the requested time."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_plugins.readers.video import FRAMES, VideoReader, sharpest_in_intervals

av = pytest.importorskip("av", reason="videos are read by PyAV: pip install av")

COUNT = 2 * FRAMES


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """160 frames of noise, every second one blurred; a bright bar tells the frame's number."""
    path = tmp_path_factory.mktemp("video") / "walk.mp4"
    rng = np.random.default_rng(0)
    noise = rng.uniform(40, 140, size=(64, 96))
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        stream.bit_rate = 4_000_000
        for number in range(COUNT):
            image = gaussian_filter(noise, 2) if number % 2 else noise.copy()
            image[:8, : number // 2 + 1] = 250
            frame = av.VideoFrame.from_ndarray(np.repeat(image.astype(np.uint8)[..., None], 3, axis=2), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_sharp_frames_of_all_parts_are_taken(video: Path) -> None:
    reader = VideoReader(NoOptions())
    assert reader.matches(video) and reader.matches(video.parent) and reader.splits(video) == ["train"]
    capture = reader.read(video)
    numbers = [int(view.name) for view in capture.views]
    assert len(numbers) == FRAMES and all(view.camera is None for view in capture.views)
    assert np.mean([number % 2 == 0 for number in numbers]) > 0.95
    assert np.diff(numbers).max() <= 3


def test_a_frame_is_the_one_of_its_time(video: Path) -> None:
    capture = VideoReader(NoOptions()).read(video.parent)
    for view in (capture.views[0], capture.views[37], capture.views[-1]):
        pixels = pickle.loads(pickle.dumps(view.read))()
        assert pixels.color_linear.shape == (64, 96, 3) and pixels.mask is None
        length = int((pixels.color_linear[2, :, 1] > 0.6).sum())
        assert abs(length - (int(view.name) // 2 + 1)) <= 2


def test_parts_give_their_best() -> None:
    assert sharpest_in_intervals(np.array([0.0, 3, 1, 1, 5, 2]), 3) == [1, 2, 4]
    assert sharpest_in_intervals(np.array([1.0, 2]), 5) == [0, 1]


def test_broken_videos_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"not a video at all")
    with pytest.raises(CaptureError, match=r"a\.mp4"):
        VideoReader(NoOptions()).read(tmp_path)
    with pytest.raises(CaptureError, match="test"):
        VideoReader(NoOptions()).read(tmp_path, "test")
