"""Stores in memory, a store with transient errors, tiny captures, and settings for fast runs."""

from __future__ import annotations

import itertools
import uuid
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from hir_plugins.commands.batch.storage.storage_path import StoragePath
from tests.fixtures.runs import make_tiny, quicker

QUICKER = quicker("geometry.photo_consistency=off", "geometry.iterations=5", "export=['glb']")


class UnreliableStore(MemoryFileSystem):
    """Objects in memory; every third request fails with a transient error, like a response with status 503."""

    protocol = "unreliable"
    requests = itertools.count(1)
    failures = 0
    read_only_name = ""
    """Files with this name cannot be written."""

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return super()._strip_protocol(path.replace("unreliable://", "memory://"))

    def _count_request(self) -> None:
        if next(UnreliableStore.requests) % 3 == 0:
            UnreliableStore.failures += 1
            raise OSError(16, "Please reduce your request rate")

    def cat_file(self, path: str, *args: object, **kwargs: object) -> bytes:
        self._count_request()
        return super().cat_file(path, *args, **kwargs)

    def pipe_file(self, path: str, *args: object, **kwargs: object) -> None:
        self._count_request()
        super().pipe_file(path, *args, **kwargs)

    def put_file(self, lpath: str, rpath: str, *args: object, **kwargs: object) -> None:
        self._count_request()
        if UnreliableStore.read_only_name and rpath.endswith(UnreliableStore.read_only_name):
            raise PermissionError(13, "Access Denied")
        super().put_file(lpath, rpath, *args, **kwargs)

    def get_file(self, rpath: str, lpath: str, *args: object, **kwargs: object) -> None:
        self._count_request()
        super().get_file(rpath, lpath, *args, **kwargs)


@pytest.fixture(scope="session", autouse=True)
def _unreliable_protocol() -> None:
    fsspec.register_implementation("unreliable", UnreliableStore, clobber=True)


@pytest.fixture
def memory() -> Iterator[StoragePath]:
    """An empty folder of a store in memory."""
    folder = StoragePath(f"memory://{uuid.uuid4().hex}")
    yield folder
    file_system, location = folder.open()
    if file_system.exists(location):
        file_system.rm(location, recursive=True)


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """8 + 1 views of 64×64; tests must not change it."""
    return make_tiny(tmp_path_factory.mktemp("captures") / "cow", train=8, test=1)
