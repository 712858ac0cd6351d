"""Uploads of `hir ui`: names that stay in their folder on every system, files that are complete or absent."""

from __future__ import annotations

import io
import resource
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hir_core.errors import InputError
from hir_plugins.commands.ui import upload as module
from hir_plugins.commands.ui.upload import (
    BLOCK_BYTES,
    MAX_DEPTH,
    MAX_FILES,
    Upload,
    capture_name,
    contained_path,
    parse_manifest,
)


def manifest(*files: tuple[str, int], name: str = "spot") -> dict[str, Any]:
    return {"name": name, "files": [{"path": path, "size": size} for path, size in files]}


@pytest.mark.parametrize(
    "path",
    [
        *("", "/", "..", "../a.png", "a/../b.png", "./a.png", "/etc/passwd", "a//b.png", "a/", "a\\b.png", "C:a.png"),
        *("a\0.png", "a\n.png", ".ssh/id", "a/.hidden", "CON", "con.png", "a/nul.txt", "a.png.", "a ", "a?.png"),
        *("\ud800.png", "a" * 201, "ä" * 101, "\u202egnp.exe", "/".join(["a"] * (MAX_DEPTH + 1))),
    ],
)
def test_names_that_could_leave_the_folder_are_refused(path: str) -> None:
    with pytest.raises(InputError):
        parse_manifest(manifest((path, 1)))


@pytest.mark.parametrize("path", ["a.png", "train/000.png", "IMG (1).JPG", "tür/Möwe 写真.jpg", "console.png", "a..b"])
def test_ordinary_names_stay_as_they_are(path: str) -> None:
    assert contained_path(path).as_posix() == path


@given(st.text(max_size=30))
def test_any_accepted_path_lies_below_the_folder(text: str) -> None:
    try:
        path = contained_path(text)
    except InputError:
        return
    folder = Path("/captures/spot")
    assert (folder / path).resolve().is_relative_to(folder) and (folder / path).resolve() != folder


@given(st.text(max_size=80))
def test_any_capture_has_a_plain_name(text: str) -> None:
    name = capture_name(text)
    assert Path(name).name == name and contained_path(name).as_posix() == name and capture_name(name) == name


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ([("a.png", 1), ("A.PNG", 1)], "occurs twice"),
        ([("e\u0301.png", 1), ("\u00e9.png", 1)], "occurs twice"),
        ([("a", 1), ("a/b.png", 1)], "a file and a folder"),
        ([], "holds no files"),
        ([("a.png", -1)], "no size"),
        ([("a.png", True)], "no size"),
        ([("a.png", 1 << 50)], "too many bytes"),
    ],
)
def test_lists_that_cannot_be_stored_are_refused(files: list[tuple[str, int]], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        parse_manifest(manifest(*files))


def test_a_list_is_limited() -> None:
    files = [(f"{number}.png", 1) for number in range(MAX_FILES + 1)]
    with pytest.raises(InputError, match="20,000"):
        parse_manifest(manifest(*files))
    assert len(parse_manifest(manifest(*files[:-1])).files) == MAX_FILES


@pytest.mark.parametrize("document", [{}, {"name": 3, "files": []}, {"name": "a", "files": [1]}, {"name": "a"}])
def test_malformed_lists_are_refused(document: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        parse_manifest(document)


def test_files_arrive_in_any_order_and_once(tmp_path: Path) -> None:
    upload = Upload(parse_manifest(manifest(("a.png", 3), ("train/b.png", 2), ("empty", 0))), tmp_path / "arriving")
    upload.receive(1, io.BytesIO(b"bb and what follows"), 2)
    with pytest.raises(InputError, match="2 files have not arrived"):
        upload.finish(tmp_path / "spot")
    upload.receive(0, io.BytesIO(b"aaa"), 3)
    upload.receive(2, io.BytesIO(), 0)
    with pytest.raises(InputError, match="sent twice"):
        upload.receive(0, io.BytesIO(b"xxx"), 3)
    upload.finish(tmp_path / "spot")
    written = {p.relative_to(tmp_path).as_posix(): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert written == {"spot/a.png": b"aaa", "spot/train/b.png": b"bb", "spot/empty": b""}


def test_an_incomplete_file_is_absent_and_may_be_sent_again(tmp_path: Path) -> None:
    upload = Upload(parse_manifest(manifest(("a.png", 5))), tmp_path / "arriving")
    with pytest.raises(InputError, match="arrived incomplete"):
        upload.receive(0, io.BytesIO(b"aa"), 5)
    assert list(upload.folder.iterdir()) == []
    with pytest.raises(InputError, match="has changed"):
        upload.receive(0, io.BytesIO(b"aaaaaa"), 6)
    with pytest.raises(InputError, match="does not contain"):
        upload.receive(1, io.BytesIO(b""), 0)
    upload.receive(0, io.BytesIO(b"aaaaa"), 5)
    upload.finish(tmp_path / "spot")
    assert (tmp_path / "spot" / "a.png").read_bytes() == b"aaaaa"


def test_one_file_is_not_written_by_two_connections(tmp_path: Path) -> None:
    upload = Upload(parse_manifest(manifest(("a.png", 1))), tmp_path / "arriving")
    begun, go_on = threading.Event(), threading.Event()

    class Slow(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            begun.set()
            go_on.wait(10)
            return super().read(size)

    first = threading.Thread(target=upload.receive, args=(0, Slow(b"a"), 1))
    first.start()
    assert begun.wait(10)
    with pytest.raises(InputError, match="sent twice"):
        upload.receive(0, io.BytesIO(b"b"), 1)
    with pytest.raises(InputError, match="not arrived"):
        upload.finish(tmp_path / "spot")
    go_on.set()
    first.join()
    assert (upload.folder / "a.png").read_bytes() == b"a"


def test_a_file_is_read_in_blocks(tmp_path: Path) -> None:
    size = 3 * BLOCK_BYTES + 5
    asked: list[int] = []

    class Watched(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            asked.append(size or 0)
            return super().read(size)

    upload = Upload(parse_manifest(manifest(("film.mp4", size))), tmp_path / "arriving")
    upload.receive(0, Watched(bytes(size)), size)
    assert max(asked) == BLOCK_BYTES and sum(asked) == size
    assert (upload.folder / "film.mp4").stat().st_size == size


def test_a_capture_larger_than_the_disk_is_refused_before_it_is_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(module.shutil, "disk_usage", lambda path: usage._replace(free=module.FREE_BYTES_KEPT + 99))
    Upload(parse_manifest(manifest(("a.png", 99))), tmp_path / "fits")
    with pytest.raises(InputError, match="type the folder's path instead"):
        Upload(parse_manifest(manifest(("a.png", 100))), tmp_path / "arriving")
    assert not (tmp_path / "arriving").exists()


def test_a_disk_that_becomes_full_names_the_file_and_what_to_do(tmp_path: Path) -> None:
    upload = Upload(parse_manifest(manifest(("a.png", 9000))), tmp_path / "arriving")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(InputError, match=r"a\.png cannot be written to .*: File too large; free some space"):
            upload.receive(0, io.BytesIO(bytes(9000)), 9000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(upload.folder.iterdir()) == []
