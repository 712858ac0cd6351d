"""Files on stores: complete or absent, and asked again where a store refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from hir_core.errors import InputError, MissingExtraError
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.object_store import Place, place
from tests.hir_plugins.commands.batch.conftest import RefusingStore


@pytest.fixture(params=["memory", "local", "refusing"])
def folder(request: pytest.FixtureRequest, memory: Place, tmp_path: Path) -> Place:
    """The same empty folder on three kinds of store."""
    if request.param == "local":
        return place(str(tmp_path / "shelf"))
    return Place(memory.url.replace("memory", request.param))


def test_files_come_back_as_they_went(folder: Place, tmp_path: Path) -> None:
    refused = RefusingStore.refused
    sources = {}
    for i in range(12):
        sources[f"train/{i:02}.png"] = tmp_path / f"{i}.png"
        sources[f"train/{i:02}.png"].write_bytes(bytes([i]) * (1000 + i))
    assert object_store.files(folder) == {} and not object_store.exists(folder)
    object_store.upload(sources, folder)
    listed = object_store.files(folder)
    assert {name: stamp.size for name, stamp in listed.items()} == {name: 1000 + i for i, name in enumerate(sources)}
    assert object_store.exists(folder) and object_store.exists(folder / "train/00.png")
    object_store.download(folder, listed, tmp_path / "back")
    assert all((tmp_path / "back" / name).read_bytes() == path.read_bytes() for name, path in sources.items())
    assert (RefusingStore.refused > refused) == folder.url.startswith("refusing")
    object_store.remove(folder)
    object_store.remove(folder)
    assert object_store.files(folder) == {} and object_store.read(folder / "train/00.png") is None


def test_write_replaces_and_create_does_not(folder: Place) -> None:
    at = folder / "batch.json"
    assert object_store.read(at) is None
    object_store.write(at, b"one")
    object_store.write(at, b"two")
    assert object_store.read(at) == b"two" and not object_store.create(at, b"three") and object_store.read(at) == b"two"
    assert object_store.create(folder / "new", b"first") and object_store.read(folder / "new") == b"first"
    assert set(object_store.files(folder)) == {"batch.json", "new"}, "no temporary file stays"


def test_one_file_is_a_place_too(memory: Place, tmp_path: Path) -> None:
    object_store.write(memory / "clip.mp4", b"frames")
    listed = object_store.files(memory / "clip.mp4")
    assert set(listed) == {""} and listed[""].size == 6
    object_store.download(memory / "clip.mp4", listed, tmp_path / "in" / "clip.mp4")
    assert (tmp_path / "in" / "clip.mp4").read_bytes() == b"frames"


def test_file_that_arrives_cut_off_is_fetched_again(memory: Place, tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    object_store.write(memory / "a.png", b"whole photograph")
    filesystem, _ = memory.opened()
    fetch, fetched = type(filesystem).get_file, []

    def cut_off(self: object, source: str, target: str, **more: object) -> None:
        fetch(self, source, target, **more)
        fetched.append(source)
        if len(fetched) == 1:
            Path(target).write_bytes(b"whole")

    monkeypatch.setattr(type(filesystem), "get_file", cut_off)
    object_store.download(memory, object_store.files(memory), tmp_path / "in")
    assert (tmp_path / "in" / "a.png").read_bytes() == b"whole photograph" and len(fetched) == 2


def test_addresses_become_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert place("shelf/cup/").url == str(tmp_path / "shelf" / "cup") and place("shelf").local == tmp_path / "shelf"
    assert place("s3://bucket/cup/") == Place("s3://bucket") / "cup" and Place("s3://bucket/cup").name == "cup"
    assert place("s3://bucket").local is None and place("file:///data/cup").local == Path("/data/cup")
    with pytest.raises(InputError, match="nonsense://x cannot be opened"):
        object_store.files(Place("nonsense://x"))


def test_missing_package_of_a_store_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(url: str) -> None:
        raise ImportError("Please install gcsfs to access Google Storage")

    monkeypatch.setattr("fsspec.url_to_fs", refuse)
    with pytest.raises(MissingExtraError, match=r"pip install 'hir\[batch-gs\]'"):
        object_store.files(Place("gs://shelf/cup"))
