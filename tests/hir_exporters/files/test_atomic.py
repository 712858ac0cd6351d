import os
from pathlib import Path

import pytest
from hir_exporters.errors import ExportError
from hir_exporters.files.atomic import atomic_directory, atomic_write, move_atomic, write_bytes_atomic


def test_bytes_appear_whole_with_their_parents(tmp_path: Path) -> None:
    write_bytes_atomic(tmp_path / "a" / "b.bin", b"new")
    assert (tmp_path / "a" / "b.bin").read_bytes() == b"new"
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b.bin"]


def test_a_failing_writer_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "kept.bin"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), atomic_write(path) as stream:
        stream.write(b"half")
        _ = 1 / 0
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["kept.bin"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the /dev/full of Linux")
def test_a_full_disk_names_the_destination(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    with pytest.raises(ExportError, match=r"file\.bin.*space"), atomic_write(path), open("/dev/full", "wb") as full:
        full.write(b"x" * 100_000)
    assert os.listdir(tmp_path) == []


def test_a_file_in_place_of_a_folder_names_the_destination(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(ExportError, match=r"file.below\.bin"):
        write_bytes_atomic(tmp_path / "file" / "below.bin", b"x")
    with pytest.raises(ExportError, match="file of that name"), atomic_directory(tmp_path / "file"):
        pass
    with pytest.raises(ExportError, match="folder of that name"):
        write_bytes_atomic(tmp_path, b"x")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="a superuser may write to read-only folders")
def test_a_read_only_folder_names_the_destination(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ExportError, match=r"x\.bin"):
        write_bytes_atomic(tmp_path / "x.bin", b"x")
    tmp_path.chmod(0o700)


def test_a_folder_is_replaced_as_a_whole_or_stays(tmp_path: Path) -> None:
    with atomic_directory(tmp_path / "d") as place:
        (place / "one").write_bytes(b"1")
    with pytest.raises(ZeroDivisionError), atomic_directory(tmp_path / "d") as place:
        (place / "two").write_bytes(b"2")
        _ = 1 / 0
    assert os.listdir(tmp_path / "d") == ["one"]
    with atomic_directory(tmp_path / "d") as place:
        (place / "two").write_bytes(b"2")
    assert os.listdir(tmp_path / "d") == ["two"] and os.listdir(tmp_path) == ["d"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs the pipes of POSIX")
def test_a_pipe_is_refused_and_stays(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.glb")
    (tmp_path / "null.glb").symlink_to("/dev/null")
    (tmp_path / "source").write_bytes(b"x")
    for name in ("pipe.glb", "null.glb"):
        with pytest.raises(ExportError, match=rf"{name}: it is not a regular file"):
            write_bytes_atomic(tmp_path / name, b"x")
        with pytest.raises(ExportError, match=rf"{name}: it is not a regular file"):
            move_atomic(tmp_path / "source", tmp_path / name)
        assert not (tmp_path / name).is_file()
