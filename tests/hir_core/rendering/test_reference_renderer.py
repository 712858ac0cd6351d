"""The renderer that measures and shows results shades all of their light, or says that it cannot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hir_core.errors import PluginError
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.scene import CameraLamp, EnvironmentMap

EXAMPLE = Path(__file__).parents[3] / "examples" / "gallery" / "lambert_sh.py"
PLUGINS = PluginManager.discover((str(EXAMPLE),))
ROOM = EnvironmentMap(torch.ones(4, 8, 3))
FLASH = replace(ROOM, lamp=CameraLamp(torch.ones(3), torch.zeros(3), torch.tensor(0.0)))


def test_a_lamp_is_not_left_out_without_a_word() -> None:
    assert reference_renderer(PLUGINS, "lambert_sh", light=ROOM)[0] == "lambert_sh"
    assert reference_renderer(PLUGINS, light=FLASH)[0] == "mitsuba_ggx"
    with pytest.raises(PluginError, match=r"'lambert_sh' does not shade the lamp .*name another renderer"):
        reference_renderer(PLUGINS, "lambert_sh", light=FLASH)
