"""Finds the mask file of a photograph by the usual names."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from hir_core.capture import View
from hir_plugins.readers.parsing.capture_paths import PHOTO_SUFFIXES

FOLDERS = ("masks", "mask", "Masks", "Mask", "object_mask", "silhouettes")
"""Usual folders of masks, beside the folder of photographs or in the capture's folder."""

_AFFIXES = ("", "mask", "masks", "alpha", "matte", "silhouette", "seg")


def match_mask(photo: Path, masks: Iterable[Path]) -> Path | None:
    """The mask of `photo` among files of the same name, without suffixes and words such as "mask"; case is ignored.

    `a.jpg` matches `a.png`, `A.PNG`, `a.jpg.png`, `a_mask.png`, `mask-a.png`, in this order of preference; a photograph
    that is a number, such as `000000.png` of DTU, matches the only mask of that number, such as `000.png`.
    """
    return MaskIndex(masks).match(photo)


class MaskIndex:
    """Mask files by their names: the search of one among 10,000 does not look at all of them."""

    def __init__(self, masks: Iterable[Path]) -> None:
        self._by_stem: dict[str, list[Path]] = {}
        self._by_plain_name: dict[str, list[Path]] = {}
        self._by_number: dict[int, list[Path]] = {}
        for mask in sorted(masks):
            if mask.suffix.lower() in PHOTO_SUFFIXES:
                self._by_stem.setdefault(mask.stem, []).append(mask)
                plain = _name_without_affixes(mask.stem)
                self._by_plain_name.setdefault(plain, []).append(mask)
                if _is_number(plain):
                    self._by_number.setdefault(int(plain), []).append(mask)

    def match(self, photo: Path) -> Path | None:
        """As `match_mask`."""
        plain = self._by_plain_name.get(_name_without_affixes(photo.stem), [])
        for found in (self._by_stem.get(photo.stem, []), self._by_stem.get(photo.name, []), plain):
            for mask in found:
                if mask != photo:
                    return mask
        same = self._by_number.get(int(photo.stem), []) if _is_number(photo.stem) else []
        return same[0] if len(same) == 1 and same[0] != photo else None


def find_mask(photo: Path, capture: Path) -> Path | None:
    """The mask of `photo` in one of `FOLDERS`, in the capture's folder or beside the folder of the photograph."""
    for parent in dict.fromkeys((capture, photo.parent.parent, photo.parent)):
        if not parent.resolve().is_relative_to(capture.resolve()):
            continue
        # Stanford-ORB: train_mask beside train
        for name in (*FOLDERS, f"{photo.parent.name}_mask", f"{photo.parent.name}_masks"):
            # photographs in subfolders (train/a.png) have masks in subfolders of the same name
            inner = _indexed(parent / name / photo.parent.name)
            mask = inner.match(photo) or _indexed(parent / name).match(photo)
            if mask is not None and mask.resolve().is_relative_to(capture.resolve()):
                return mask
    return None


def unmatched_masks(photos: Iterable[Path], capture: Path) -> list[Path]:
    """Files in the capture's folders of masks that belong to none of its photographs."""
    photos = list(photos)
    matched = {find_mask(photo, capture) for photo in photos}
    listed = [file for name in FOLDERS for file in _listed(capture / name) if file.suffix.lower() in PHOTO_SUFFIXES]
    return [file for file in dict.fromkeys(listed) if file not in matched and file not in photos]


@lru_cache(maxsize=64)
def _listed_at(folder: Path, changed_ns: int) -> tuple[Path, ...]:
    del changed_ns  # part of the cache's key: a changed folder is listed again
    return tuple(sorted(p for p in folder.iterdir() if p.is_file()))


def _listed(folder: Path) -> tuple[Path, ...]:
    try:
        return _listed_at(folder, folder.stat().st_mtime_ns) if folder.is_dir() else ()
    except OSError:
        return ()


@lru_cache(maxsize=64)
def _index_at(folder: Path, changed_ns: int) -> MaskIndex:
    return MaskIndex(_listed_at(folder, changed_ns))


def _indexed(folder: Path) -> MaskIndex:
    try:
        return _index_at(folder, folder.stat().st_mtime_ns) if folder.is_dir() else MaskIndex(())
    except OSError:
        return MaskIndex(())


def warn_of_matches_by_number(views: Iterable[View]) -> None:
    """Says once which masks were matched by number only, such as `000.png` for `000000.png` in folders of DTU."""
    pairs = [(view.path, view.mask_path) for view in views if view.path is not None and view.mask_path is not None]
    matched = [(p, m) for p, m in pairs if _name_without_affixes(p.stem) != _name_without_affixes(m.stem)]
    if matched:
        photo, mask = matched[0]
        warnings.warn(
            f"{len(matched)} masks are matched by number, such as {mask.name} with {photo.name}; if that is wrong, "
            "name masks like their photographs",
            stacklevel=3,
        )


def _is_number(stem: str) -> bool:
    return stem.isascii() and stem.isdecimal() and len(stem) < 19


def _name_without_affixes(stem: str) -> str:
    """A name in lower case, without image suffixes and words such as "mask"."""
    name = stem.lower()
    for suffix in PHOTO_SUFFIXES:
        name = name.removesuffix(suffix)
    for word in _AFFIXES[1:]:
        for separator in ("_", "-", ".", " "):
            name = name.removesuffix(separator + word).removeprefix(word + separator)
    return name
