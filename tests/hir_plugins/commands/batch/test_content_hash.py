"""Hashes: equal for equal content, different if anything changes that a result depends on."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from hir_core.config import GeometrySettings, ReflectanceSettings, RunConfig
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import content_hash, listing_hash, result_key, settings_hash
from hir_plugins.commands.batch.storage.storage_path import StoragePath


def test_content_hash_depends_on_names_and_bytes_only(tiny: Path, tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere"
    shutil.copytree(tiny, copy)
    os.utime(copy / "transforms_train.json", (1, 1))
    assert content_hash(copy) == content_hash(tiny)
    changed = copy / "train" / next(file.name for file in (copy / "train").iterdir())
    before = content_hash(copy)
    changed.write_bytes(changed.read_bytes()[:-1] + b"?")
    assert content_hash(copy) != before
    changed.rename(changed.with_name("renamed.png"))
    assert content_hash(copy) not in (before, content_hash(tiny))


def test_listing_hash_changes_with_content_of_the_same_size(memory: StoragePath, tmp_path: Path) -> None:
    for folder in (memory, StoragePath(str(tmp_path / "cup"))):
        object_store.write(folder / "a.png", b"red")
        before = listing_hash(object_store.list_files(folder))
        assert listing_hash(object_store.list_files(folder)) == before
        object_store.write(folder / "a.png", b"sea")
        assert listing_hash(object_store.list_files(folder)) != before


def test_settings_hash_covers_settings_that_change_the_result(tmp_path: Path) -> None:
    default = settings_hash(RunConfig())
    assert settings_hash(RunConfig()) == default
    assert settings_hash(RunConfig(observers={"previews": {}}, checkpoint_seconds=1.0)) == default
    assert settings_hash(RunConfig(seed=1)) != default
    assert settings_hash(RunConfig(geometry=GeometrySettings(iterations=399))) != default


def test_settings_hash_covers_the_bytes_of_named_files(tmp_path: Path) -> None:
    light = tmp_path / "hall.hdr"
    light.write_bytes(b"noon")
    config = RunConfig(reflectance=ReflectanceSettings(known_environment=f"{light}*2.5"))
    noon = settings_hash(config)
    light.write_bytes(b"dusk")
    assert settings_hash(config) != noon
    plugin = tmp_path / "term.py"
    plugin.write_text("weight = 1")
    one = settings_hash(replace(config, plugins=(str(plugin),)))
    plugin.write_text("weight = 2")
    assert settings_hash(replace(config, plugins=(str(plugin),))) != one


def test_result_key_depends_on_content_and_settings() -> None:
    assert len({result_key(a, b) for a in ("x", "y") for b in ("x", "y")}) == 4
