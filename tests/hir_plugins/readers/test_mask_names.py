"""Masks whose names match photographs partly: one sentence says how many do, and what to rename."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.llff import LlffReader
from hir_plugins.readers.photos import PhotosReader
from hir_plugins.readers.transforms_json import TransformsJsonReader

COUNT = 12


def pictures(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        Image.fromarray(np.zeros((48, 64), np.uint8)).save(folder / f"{name}.png")


def llff(folder: Path, masks: list[str]) -> Path:
    """Twelve photographs, numbered with six digits from 0."""
    matrix = np.array([[0, 1, 0, 0, 48], [1, 0, 0, 0, 64], [0, 0, -1, -5, 80.0]])
    np.save(folder / "poses_bounds.npy", np.tile(np.concatenate([matrix.reshape(-1), [1, 9]]), (COUNT, 1)))
    pictures(folder / "images", [f"{i:06}" for i in range(COUNT)])
    pictures(folder / "masks", masks)
    return folder


def said(reader: CaptureReader, folder: Path, split: str = "train") -> tuple[int, list[str]]:
    """Views with a mask file, and what the reader warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        capture = reader.read(folder, split)
    return sum(view.mask_path is not None for view in capture.views), [str(w.message) for w in caught]


LLFF, TRANSFORMS = LlffReader(NoOptions()), TransformsJsonReader(NoOptions())


def test_masks_of_the_same_names_are_silent(tmp_path: Path) -> None:
    assert said(LLFF, llff(tmp_path, [f"{i:06}" for i in range(COUNT)])) == (COUNT, [])


def test_masks_of_the_same_numbers_are_named(tmp_path: Path) -> None:
    count, [sentence] = said(LLFF, llff(tmp_path, [f"{i:03}" for i in range(COUNT)]))
    assert count == COUNT and sentence.startswith("12 masks are matched by number, such as 000.png with 000000.png")


def test_masks_that_are_numbered_otherwise_are_named(tmp_path: Path) -> None:
    """Numbers from 11: one of the twelve masks belongs to a photograph, and is probably that of another one."""
    count, [sentence] = said(LLFF, llff(tmp_path, [f"{i:03}" for i in range(11, 11 + COUNT)]))
    assert count == 1
    assert "1 of 12 masks belong to a photograph (by number, such as 011.png to 000011.png)" in sentence
    assert "11 of 12 photographs have no mask" in sentence and "012.png belongs to none" in sentence
    assert "rename the masks" in sentence and "such as 000000.png" in sentence


def test_masks_that_match_nothing_are_named(tmp_path: Path) -> None:
    count, [sentence] = said(LLFF, llff(tmp_path, [f"object_{i}" for i in range(COUNT)]))
    assert count == 0 and sentence.startswith("0 of 12 masks belong to a photograph, and 12 of 12 photographs")


def test_photographs_without_a_mask_alone_are_no_problem_of_names(tmp_path: Path) -> None:
    assert said(LLFF, llff(tmp_path, [f"{i:06}" for i in range(5)])) == (5, [])


def test_further_masks_are_no_problem_where_no_photograph_lacks_one(tmp_path: Path) -> None:
    assert said(LLFF, llff(tmp_path, [f"{i:06}" for i in range(COUNT + 3)])) == (COUNT, [])


@pytest.mark.parametrize("flat", [True, False])
def test_masks_of_another_split_belong_to_its_photographs(tmp_path: Path, flat: bool) -> None:
    """In folders of their own or all in one; a photograph of the training split without a mask changes nothing."""
    names = {"train": ["a", "b", "c"], "test": ["d", "e"]}
    for split, of_split in names.items():
        pictures(tmp_path / split, of_split)
        pictures(tmp_path / "masks" / ("" if flat else split), [n for n in of_split if n != "c"])
        frames = [{"file_path": f"{split}/{n}.png", "transform_matrix": np.eye(4).tolist()} for n in of_split]
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    assert said(TRANSFORMS, tmp_path) == (2, []) and said(TRANSFORMS, tmp_path, "test") == (2, [])
    pictures(tmp_path / "masks" / ("" if flat else "train"), ["g"])
    [sentence] = said(TRANSFORMS, tmp_path)[1]
    assert "g.png belongs to none" in sentence and "1 of 3 photographs have no mask" in sentence


def test_masks_of_photographs_that_the_cameras_leave_out_belong_to_them(tmp_path: Path) -> None:
    """A program registers some of the photographs: those without a camera lie in the same folder."""
    pictures(tmp_path / "images", ["a", "b", "c", "d"])
    pictures(tmp_path / "masks", ["a", "c", "d"])
    frames = [{"file_path": f"images/{n}.png", "transform_matrix": np.eye(4).tolist()} for n in "ab"]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    assert said(TRANSFORMS, tmp_path) == (1, [])


def test_a_folder_of_photographs_says_it_once(tmp_path: Path) -> None:
    pictures(tmp_path / "images", ["a", "b", "c"])
    pictures(tmp_path / "masks", ["a", "x"])
    count, [sentence] = said(PhotosReader(NoOptions()), tmp_path)
    assert count == 1 and sentence.startswith("1 of 2 masks belong to a photograph, and 2 of 3 photographs")
