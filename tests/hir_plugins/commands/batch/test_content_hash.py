"""Marks: equal for equal content, different for anything a result depends on."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from hir_core.config import GeometrySettings, ReflectanceSettings, RunConfig
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import content_mark, listing_mark, settings_mark, work_mark
from hir_plugins.commands.batch.storage.object_store import Place


def test_content_is_that_of_the_bytes_wherever_they_lie(tiny: Path, tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere"
    shutil.copytree(tiny, copy)
    os.utime(copy / "transforms_train.json", (1, 1))
    assert content_mark(copy) == content_mark(tiny)
    changed = copy / "train" / next(file.name for file in (copy / "train").iterdir())
    before = content_mark(copy)
    changed.write_bytes(changed.read_bytes()[:-1] + b"?")
    assert content_mark(copy) != before
    changed.rename(changed.with_name("renamed.png"))
    assert content_mark(copy) not in (before, content_mark(tiny))


def test_listing_notices_a_change_of_the_same_size(memory: Place, tmp_path: Path) -> None:
    for folder in (memory, Place(str(tmp_path / "cup"))):
        object_store.write(folder / "a.png", b"red")
        before = listing_mark(object_store.files(folder))
        assert listing_mark(object_store.files(folder)) == before
        object_store.write(folder / "a.png", b"sea")
        assert listing_mark(object_store.files(folder)) != before


def test_settings_count_when_they_change_the_result(tmp_path: Path) -> None:
    usual = settings_mark(RunConfig())
    assert settings_mark(RunConfig()) == usual
    assert settings_mark(RunConfig(observers={"previews": {}}, checkpoint_seconds=1.0)) == usual
    assert settings_mark(RunConfig(seed=1)) != usual
    assert settings_mark(RunConfig(geometry=GeometrySettings(iterations=399))) != usual


def test_file_that_a_setting_names_counts_with_its_bytes(tmp_path: Path) -> None:
    light = tmp_path / "hall.hdr"
    light.write_bytes(b"noon")
    config = RunConfig(reflectance=ReflectanceSettings(known_environment=f"{light}*2.5"))
    noon = settings_mark(config)
    light.write_bytes(b"dusk")
    assert settings_mark(config) != noon
    plugin = tmp_path / "term.py"
    plugin.write_text("weight = 1")
    one = settings_mark(replace(config, plugins=(str(plugin),)))
    plugin.write_text("weight = 2")
    assert settings_mark(replace(config, plugins=(str(plugin),))) != one


def test_work_is_input_and_settings() -> None:
    assert len({work_mark(a, b) for a in ("x", "y") for b in ("x", "y")}) == 4
