"""The reader of a capture: which one is used where several match."""

from __future__ import annotations

import types
import warnings
from pathlib import Path

import pytest

from hir_core.capture import Capture
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.manager import PluginManager
from hir_core.testing.captures import tiny_capture
from hir_plugins.readers.contract_inputs import transforms_json
from hir_plugins.readers.transforms_json import TransformsJsonReader


class Greedy(TransformsJsonReader):
    """A second reader of the same format."""

    def read(self, path: Path, split: str = "train") -> Capture:
        return super().read(path, split)


def plugins_with_second_reader(name: str) -> PluginManager:
    manager = PluginManager.discover()
    component = Component(name, f"{__name__}:Greedy")
    register = hookimpl(lambda: [component])
    manager.register(types.SimpleNamespace(__name__="made", hir_register_capture_readers=register), "studio", "1.0")
    assert manager.problems == []
    return manager


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    (tmp_path / "written").mkdir()
    return transforms_json(tiny_capture(tmp_path / "truth", views=2, size=16).capture, tmp_path / "written")


@pytest.mark.parametrize(
    ("second", "used", "other"),
    [("a_second", "a_second", "transforms_json"), ("z_second", "transforms_json", "z_second")],
)
def test_the_reader_that_is_used_is_said_where_two_match(capture: Path, second: str, used: str, other: str) -> None:
    with pytest.warns(UserWarning) as caught:
        assert read_capture(capture, "train", plugins_with_second_reader(second)).reader == used
    assert [str(warning.message) for warning in caught] == [
        f"{capture} is read as {used}, the first in the order of names; {other} could read it, too: select one "
        f'by --set reader="{other}"'
    ]


@pytest.mark.parametrize(("second", "reader"), [("", "auto"), ("a_second", "transforms_json")])
def test_nothing_is_said_where_one_matches_or_one_is_selected(capture: Path, second: str, reader: str) -> None:
    plugins = plugins_with_second_reader(second) if second else PluginManager.discover()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_capture(capture, "train", plugins, reader).reader == "transforms_json"
