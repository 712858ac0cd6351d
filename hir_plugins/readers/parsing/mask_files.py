"""Finds the mask file of a photograph by the usual names."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from hir_core.capture import View
from hir_plugins.readers.parsing.capture_paths import PHOTO_SUFFIXES, is_photo_name

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
            if is_photo_name(mask.name):
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
    for folder in _mask_folders(photo, capture):
        mask = _indexed(folder).match(photo)
        if mask is not None and mask.resolve().is_relative_to(capture.resolve()):
            return mask
    return None


def _mask_folders(photo: Path, capture: Path) -> Iterator[Path]:
    """Where the mask of a photograph may lie, in the order of preference; they need not exist."""
    for parent in dict.fromkeys((capture, photo.parent.parent, photo.parent)):
        if not parent.resolve().is_relative_to(capture.resolve()):
            continue
        # Stanford-ORB: train_mask beside train
        for name in (*FOLDERS, f"{photo.parent.name}_mask", f"{photo.parent.name}_masks"):
            # photographs in subfolders (train/a.png) have masks in subfolders of the same name
            yield parent / name / photo.parent.name
            yield parent / name


@dataclass(frozen=True)
class FoundMasks:
    """The mask files of a capture, divided by whether a photograph has their name."""

    of_photographs: tuple[Path, ...]
    of_none: tuple[Path, ...]


def found_masks(photos: Sequence[Path], capture: Path, others: Iterable[Path] = ()) -> FoundMasks:
    """The files in all folders in which masks of these photographs are looked for.

    Masks of `others` belong to a photograph, too, and those of other files in the folders of the photographs: a camera
    file may list some only. `others` is read where there are masks.
    """
    folders = {photo.parent: photo for photo in photos}
    listed = [file for photo in folders.values() for each in _mask_folders(photo, capture) for file in _listed(each)]
    masks = [file for file in dict.fromkeys(listed) if is_photo_name(file.name)]
    if not masks:
        return FoundMasks((), ())
    beside = [file for folder in folders for file in _listed(folder) if is_photo_name(file.name)]
    known = dict.fromkeys((*photos, *beside, *others))
    matched = {find_mask(photo, capture) for photo in known}
    rest = [file for file in masks if file not in known]
    return FoundMasks(tuple(f for f in rest if f in matched), tuple(f for f in rest if f not in matched))


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


def warn_of_mask_names(matches: Iterable[tuple[Path, Path | None]], capture: Path, others: Iterable[Path] = ()) -> None:
    """Says once where photographs lack a mask and masks lack a photograph, or else which masks match by number only.

    `matches` are the photographs of the capture, each with its mask; `others` are photographs that it leaves out and
    that lie elsewhere, such as those of another split, read where masks are missing.
    """
    matches = list(matches)
    missing = [photo for photo, mask in matches if mask is None]
    found = found_masks([photo for photo, _ in matches], capture, others) if missing else FoundMasks((), ())
    pairs = [(photo, mask) for photo, mask in matches if mask is not None]
    by_number = [(p, m) for p, m in pairs if _name_without_affixes(p.stem) != _name_without_affixes(m.stem)]
    if found.of_none:
        masks = len(found.of_none) + len(found.of_photographs)
        example = f" (by number, such as {by_number[0][1].name} to {by_number[0][0].name})" if by_number else ""
        warnings.warn(
            f"{len(found.of_photographs)} of {masks} masks belong to a photograph{example}, and {len(missing)} of "
            f"{len(matches)} photographs have no mask: {found.of_none[0]} belongs to none; rename the masks so that "
            f"their names or numbers are those of the photographs, such as {missing[0].stem}.png",
            stacklevel=3,
        )
    elif by_number:
        photo, mask = by_number[0]
        warnings.warn(
            f"{len(by_number)} masks are matched by number, such as {mask.name} with {photo.name}; if that is wrong, "
            "name masks like their photographs",
            stacklevel=3,
        )


def matches_of(views: Iterable[View]) -> list[tuple[Path, Path | None]]:
    """Photograph and mask file of each view, as far as they are files."""
    return [(view.path, view.mask_path) for view in views if view.path is not None]


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
