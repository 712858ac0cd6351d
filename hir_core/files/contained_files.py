"""Files that a document of a run names, or that lie at a fixed place in it: regular files inside the run's folder."""

from __future__ import annotations

from pathlib import Path

from hir_core.errors import InputError


def regular_file_within(folder: Path, path: Path) -> Path:
    """`path`, a regular file in `folder` also after links are resolved; anything else raises `InputError`."""
    try:
        contained, regular = path.resolve().is_relative_to(folder.resolve()), path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # a cycle of links, a null character, half a character
        raise InputError(f"{str(path)!r} is not a file name ({type(error).__name__}); write the run again") from None
    if not contained:
        raise InputError(f"{path} leads out of {folder}; remove it, and write it again with: hir report")
    if not regular:
        raise InputError(f"{path} is missing or not a regular file; write it again with: hir report")
    return path


def named_file(folder: Path, directory: Path, name: object) -> Path:
    """As `regular_file_within(folder, …)`, for the plain file name `name` in `directory`."""
    if not isinstance(name, str) or not name or name != Path(name).name or "\\" in name:
        raise InputError(f"{directory}: {str(name)[:80]!r} is not a plain file name; write it again with: hir report")
    return regular_file_within(folder, directory / name)
