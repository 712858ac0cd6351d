"""Stores that live in memory or refuse now and then, tiny captures, and settings that are fast rather than good."""

from __future__ import annotations

import itertools
import uuid
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from hir_plugins.commands.batch.storage.object_store import Place
from tests.fixtures.runs import QUICK, make_tiny

QUICKER = (
    *QUICK,
    "geometry.photographs=off",
    "geometry.iterations=5",
    "export=['glb']",
)


class RefusingStore(MemoryFileSystem):
    """Objects in memory; every third request fails as a store's answer 503 does."""

    protocol = "refusing"
    requests = itertools.count(1)
    refused = 0

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return super()._strip_protocol(path.replace("refusing://", "memory://"))

    def _answer(self) -> None:
        if next(RefusingStore.requests) % 3 == 0:
            RefusingStore.refused += 1
            raise OSError(16, "Please reduce your request rate")

    def cat_file(self, path: str, *words: object, **more: object) -> bytes:
        self._answer()
        return super().cat_file(path, *words, **more)

    def pipe_file(self, path: str, *words: object, **more: object) -> None:
        self._answer()
        super().pipe_file(path, *words, **more)

    def put_file(self, lpath: str, rpath: str, *words: object, **more: object) -> None:
        self._answer()
        super().put_file(lpath, rpath, *words, **more)

    def get_file(self, rpath: str, lpath: str, *words: object, **more: object) -> None:
        self._answer()
        super().get_file(rpath, lpath, *words, **more)


@pytest.fixture(scope="session", autouse=True)
def _refusing_protocol() -> None:
    fsspec.register_implementation("refusing", RefusingStore, clobber=True)


@pytest.fixture
def memory() -> Iterator[Place]:
    """An empty folder of a store in memory."""
    at = Place(f"memory://{uuid.uuid4().hex}")
    yield at
    filesystem, path = at.opened()
    if filesystem.exists(path):
        filesystem.rm(path, recursive=True)


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """8 + 1 views of 64×64; tests must not change it."""
    return make_tiny(tmp_path_factory.mktemp("shelf") / "cow", train=8, test=1)
