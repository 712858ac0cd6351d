"""Takes of a capture: their names, and takes.toml, which lists the folders of their photographs."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from hir_exporters.files.regular_files import refuse_special_file

from hir_core.capture import View
from hir_core.errors import CaptureError, InputError
from hir_plugins.readers.parsing.capture_paths import contained_path, photos_of
from hir_plugins.readers.parsing.mask_files import FOLDERS as MASK_FOLDERS

TAKES_FILE: Final = "takes.toml"
MAX_NAME_LENGTH: Final = 100
MAX_TAKES: Final = 100
MAX_BYTES: Final = 64 << 10
"""Largest accepted size of takes.toml."""
MAX_DOTS: Final = 1_000
"""In takes.toml; the names of folders may have some."""

_EXAMPLE: Final = 'takes = ["standing", "upside_down"]'


def take_name(value: object, owner: str) -> str:
    """The name of a take, from untrusted input; anything but a short, printable text raises `CaptureError`."""
    if not isinstance(value, str) or not value.strip() or len(value) > MAX_NAME_LENGTH or not value.isprintable():
        shown = repr(value[:MAX_NAME_LENGTH]) if isinstance(value, str) else f"of type {type(value).__name__}"
        raise CaptureError(
            f"{owner}: the take {shown} is not a name; write a text of 1 to {MAX_NAME_LENGTH} printable characters, "
            "such as 'standing'"
        )
    return value


def has_takes_file(capture: Path) -> bool:
    """Whether a folder lists takes; the file is not opened."""
    return (capture / TAKES_FILE).is_file()


def read_takes(capture: Path) -> tuple[str, ...]:
    """The names in `capture`/takes.toml, in its order, each a plain name of a folder; empty without the file.

    Whether the folders exist is not checked. A file that is not such a list of two names or more raises `CaptureError`.
    """
    if not has_takes_file(capture):
        return ()
    file = capture / TAKES_FILE
    table = _table(file)
    unknown = sorted(set(table) - {"takes"})
    if unknown:
        raise CaptureError(f"{file}: the key {unknown[0][:MAX_NAME_LENGTH]!r} is unknown; write only: {_EXAMPLE}")
    listed = table.get("takes")
    if not isinstance(listed, list) or len(listed) < 2:
        raise CaptureError(f"{file} does not list two takes or more; name the folders of the takes: {_EXAMPLE}")
    if len(listed) > MAX_TAKES:
        raise CaptureError(f"{file} lists {len(listed)} takes; list at most {MAX_TAKES}")
    names = [take_name(value, str(file)) for value in listed]
    for name in names:
        if name.startswith(".") or any(character in name for character in "/\\:"):
            raise CaptureError(f"{file}: the take {name!r} is not the name of a folder in the capture; give its name")
    repeated = [name for i, name in enumerate(names) if name in names[:i]]
    if repeated:
        raise CaptureError(f"{file} lists the take {repeated[0]!r} twice; list each folder once")
    return tuple(names)


def take_folders(capture: Path, names: Sequence[str], folders: Iterable[str]) -> list[Path]:
    """The folders of the takes, all in the first of the capture's `folders` that has one of them.

    A missing one, and one that leads out of the capture, raise `CaptureError`.
    """
    file = capture / TAKES_FILE
    for parent in folders:
        found = [contained_path(capture, f"{parent}/{name}", file) for name in names]
        missing = [name for name, folder in zip(names, found, strict=True) if not folder.is_dir()]
        if len(missing) < len(names):
            if missing:
                raise CaptureError(
                    f"{file} lists the take {missing[0]!r}, which is not a folder in {capture / parent}; add the "
                    "folder, or correct its name"
                )
            if len({folder.resolve() for folder in found}) < len(found):
                raise CaptureError(f"{file} lists one folder under two names; list each folder once")
            return found
    raise CaptureError(
        f"{file} lists the take {names[0]!r}, which is not a folder in {capture}; add the folder, or correct its name"
    )


def unlisted_photographs(capture: Path, folders: Sequence[Path]) -> list[Path]:
    """Photographs beside the takes' folders, or in other folders beside them, that belong to no take."""
    parents = list(dict.fromkeys((capture, folders[0].parent)))
    beside = [p for parent in parents for p in sorted(parent.iterdir()) if p.is_dir() and not p.is_symlink()]
    others = [p for p in dict.fromkeys((*parents, *beside)) if p not in folders and not _is_mask_folder(p)]
    found: list[Path] = []
    for folder in others:
        with suppress(PermissionError):  # such as lost+found: what cannot be listed is no photograph of the capture
            found += photos_of(folder)
    return found


def with_takes(views: Sequence[View], capture: Path, whole: bool = True) -> tuple[View, ...]:
    """The views with the takes that takes.toml lists, in its order; without the file as they are.

    A photograph belongs to the take whose name the first such folder on its path has; a photograph of no take raises
    `CaptureError`. Of a `whole` capture, not one of its splits, a take without a photograph is a warning.
    """
    names = read_takes(capture)
    if not names:
        return tuple(views)
    file = capture / TAKES_FILE
    labelled = []
    for view in views:
        path = Path(view.name) if view.path is None else view.path.relative_to(capture)
        take = next((part for part in path.parts[:-1] if part in names), None)
        if take is None:
            raise CaptureError(
                f"{file}: the photograph {path.as_posix()} lies in no folder of the takes {', '.join(names[:5])}; move "
                "it into one, or list its folder"
            )
        labelled.append(replace(view, take=take))
    without = [name for name in names if all(view.take != name for view in labelled)]
    if without and whole:
        warnings.warn(
            f"{file} lists the take {without[0]!r}, of which no photograph has a camera; align its photographs "
            "together with those of the other takes",
            stacklevel=3,
        )
    refuse_shared_masks(labelled)
    return tuple(sorted(labelled, key=lambda view: names.index(view.take)))


def refuse_shared_masks(views: Iterable[View]) -> None:
    """`CaptureError` where photographs of two takes have one mask file: photographs of the same name, masks in one
    folder.
    """
    owner: dict[Path, View] = {}
    for view in views:
        if view.mask_path is None:
            continue
        other = owner.setdefault(view.mask_path, view)
        if other.take != view.take:
            raise CaptureError(
                f"the mask {view.mask_path} belongs to photographs of two takes, {other.name} and {view.name}; put the "
                f"masks of a take into a folder of their own, such as masks/{view.take}"
            )


def _is_mask_folder(folder: Path) -> bool:
    return folder.name in MASK_FOLDERS or folder.name.endswith(("_mask", "_masks"))


def _table(file: Path) -> dict[str, Any]:
    try:
        if file.stat().st_size > MAX_BYTES:
            raise CaptureError(f"{file} is larger than {MAX_BYTES >> 10} kB; it is not a list of takes")
        refuse_special_file(file)
        text = file.read_text(encoding="utf-8")
        if text.count(".") > MAX_DOTS:  # a key of many parts takes time and memory that grow with their square
            raise CaptureError(f"{file} has more than {MAX_DOTS} dots; it is not a list of takes")
        return tomllib.loads(text)
    except CaptureError:
        raise
    except InputError as error:
        raise CaptureError(str(error)) from None
    except OSError as error:
        raise CaptureError(f"{file} cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:  # also bytes that are not UTF-8
        raise CaptureError(f"{file} is not valid TOML ({error}); write: {_EXAMPLE}") from None
