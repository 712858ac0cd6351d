"""The assets and the measurement of the whole export command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import textures, validate_asset
from hir_exporters.scene_format import save_scene

from hir_core.errors import HirError
from hir_plugins.commands.bench.suites.export_command_rows import grained_asset, measured_command


@pytest.mark.parametrize("kind", ["metallic", "dielectric"])
def test_assets_are_valid_and_repeat(kind: str) -> None:
    asset, again = grained_asset(kind, 64), grained_asset(kind, 64)
    validate_asset(asset)
    assert asset.material.model == kind
    for (name, one), (other, two) in zip(textures(asset.material), textures(again.material), strict=True):
        assert name == other and np.array_equal(one, two) and one.std() > 0.001


def test_command_is_timed_with_its_start_and_its_failure_is_an_error(tmp_path: Path) -> None:
    save_scene(grained_asset("metallic", 32), tmp_path / "scene")
    timing, size = measured_command(tmp_path / "scene", tmp_path / "files", ("-f", "glb", "--no-verify"), 1)
    assert timing.cpu > 0.05  # importing numpy alone takes longer
    assert size == sum(file.stat().st_size for file in (tmp_path / "files").iterdir()) > 10_000
    with pytest.raises(HirError, match="no exporter named 'nothing'"):
        measured_command(tmp_path / "scene", tmp_path / "files", ("-f", "nothing"), 1)
