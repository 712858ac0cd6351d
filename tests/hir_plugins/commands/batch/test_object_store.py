"""Files on stores: complete or absent, with retries after transient errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from hir_core.errors import InputError, MissingExtraError
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.storage_path import StoragePath, parse_storage_path
from tests.hir_plugins.commands.batch.conftest import UnreliableStore


@pytest.fixture(params=["memory", "local", "unreliable"])
def folder(request: pytest.FixtureRequest, memory: StoragePath, tmp_path: Path) -> StoragePath:
    """The same empty folder on three kinds of store."""
    if request.param == "local":
        return parse_storage_path(str(tmp_path / "captures"))
    return StoragePath(memory.url.replace("memory", request.param))


def test_uploaded_files_are_downloaded_unchanged(folder: StoragePath, tmp_path: Path) -> None:
    failures = UnreliableStore.failures
    sources = {}
    for i in range(12):
        sources[f"train/{i:02}.png"] = tmp_path / f"{i}.png"
        sources[f"train/{i:02}.png"].write_bytes(bytes([i]) * (1000 + i))
    assert object_store.list_files(folder) == {} and not object_store.exists(folder)
    object_store.upload(sources, folder)
    listed = object_store.list_files(folder)
    assert {name: stat.size for name, stat in listed.items()} == {name: 1000 + i for i, name in enumerate(sources)}
    assert object_store.exists(folder) and object_store.exists(folder / "train/00.png")
    object_store.download(folder, listed, tmp_path / "back")
    assert all((tmp_path / "back" / name).read_bytes() == path.read_bytes() for name, path in sources.items())
    assert (UnreliableStore.failures > failures) == folder.url.startswith("unreliable")
    object_store.remove(folder)
    object_store.remove(folder)
    assert object_store.list_files(folder) == {} and object_store.read(folder / "train/00.png") is None


def test_write_replaces_and_create_does_not(folder: StoragePath) -> None:
    path = folder / "batch.json"
    assert object_store.read(path) is None
    object_store.write(path, b"one")
    object_store.write(path, b"two")
    assert (
        object_store.read(path) == b"two"
        and not object_store.create(path, b"three")
        and object_store.read(path) == b"two"
    )
    assert object_store.create(folder / "new", b"first") and object_store.read(folder / "new") == b"first"
    assert set(object_store.list_files(folder)) == {"batch.json", "new"}, "no temporary file remains"


def test_one_file_is_a_capture_too(memory: StoragePath, tmp_path: Path) -> None:
    object_store.write(memory / "clip.mp4", b"frames")
    listed = object_store.list_files(memory / "clip.mp4")
    assert set(listed) == {""} and listed[""].size == 6
    object_store.download(memory / "clip.mp4", listed, tmp_path / "in" / "clip.mp4")
    assert (tmp_path / "in" / "clip.mp4").read_bytes() == b"frames"


def test_truncated_download_is_repeated(memory: StoragePath, tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    object_store.write(memory / "a.png", b"whole photograph")
    file_system, _ = memory.open()
    get_file, fetched = type(file_system).get_file, []

    def truncating(self: object, source: str, target: str, **kwargs: object) -> None:
        get_file(self, source, target, **kwargs)
        fetched.append(source)
        if len(fetched) == 1:
            Path(target).write_bytes(b"whole")

    monkeypatch.setattr(type(file_system), "get_file", truncating)
    object_store.download(memory, object_store.list_files(memory), tmp_path / "in")
    assert (tmp_path / "in" / "a.png").read_bytes() == b"whole photograph" and len(fetched) == 2


def test_addresses_are_parsed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        parse_storage_path("captures/cup/").url == str(tmp_path / "captures" / "cup")
        and parse_storage_path("captures").local == tmp_path / "captures"
    )
    assert (
        parse_storage_path("s3://bucket/cup/") == StoragePath("s3://bucket") / "cup"
        and StoragePath("s3://bucket/cup").name == "cup"
    )
    assert parse_storage_path("s3://bucket").local is None and parse_storage_path("file:///data/cup").local == Path(
        "/data/cup"
    )
    with pytest.raises(InputError, match="nonsense://x cannot be opened"):
        object_store.list_files(StoragePath("nonsense://x"))


def test_missing_package_of_a_store_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(url: str) -> None:
        raise ImportError("Please install gcsfs to access Google Storage")

    monkeypatch.setattr("fsspec.url_to_fs", refuse)
    with pytest.raises(MissingExtraError, match=r"pip install 'hir\[batch-gs\]'"):
        object_store.list_files(StoragePath("gs://captures/cup"))
