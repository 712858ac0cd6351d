"""Presets name the components of a run: `hir_core` has no default of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from hir_core.config import load_config
from hir_core.errors import ConfigError
from hir_core.plugins.manager import PluginManager

COMPLETE = {
    "export": 'export = ["glb"]\n',
    "geometry.renderer": '[geometry]\nrenderer = "contour"\n',
    "reflectance.renderer": '[reflectance]\nrenderer = "transport_ggx"\n',
    "reflectance.path_tracing.renderer": '[reflectance.path_tracing]\nrenderer = "mitsuba_ggx"\n',
}


class Presets:
    """A plugin with presets of this text."""

    def __init__(self, folder: Path, **presets: str) -> None:
        self._paths = {name: folder / f"{name}.toml" for name in presets}
        for name, text in presets.items():
            self._paths[name].write_text(text, encoding="utf-8")

    def hir_register_presets(self) -> dict[str, Path]:
        return self._paths


def manager(folder: Path, **presets: str) -> PluginManager:
    from hir_core.plugins import hookimpl

    plugin = type("Marked", (Presets,), {"hir_register_presets": hookimpl(Presets.hir_register_presets)})
    plugins = PluginManager.discover()
    plugins.register(plugin(folder, **presets), "test", "1")
    assert not plugins.problems
    return plugins


@pytest.mark.parametrize("missing", COMPLETE)
def test_a_preset_without_a_component_is_an_error_that_names_the_setting(missing: str, tmp_path: Path) -> None:
    text = "".join(part for setting, part in COMPLETE.items() if setting != missing)
    plugins = manager(tmp_path, complete="".join(COMPLETE.values()), incomplete=text)
    assert load_config(plugins, "complete").geometry.renderer == "contour"
    with pytest.raises(ConfigError, match=rf"preset 'incomplete' does not set {missing}; set it to "):
        load_config(plugins, "incomplete")


def test_renderers_of_stages_that_do_not_run_need_not_be_set(tmp_path: Path) -> None:
    text = COMPLETE["export"] + "[geometry]\nenabled = false\n[reflectance]\nenabled = false\n"
    assert not load_config(manager(tmp_path, bare=text), "bare").reflectance.enabled
    text = COMPLETE["export"] + COMPLETE["geometry.renderer"] + COMPLETE["reflectance.renderer"]
    gradient = load_config(manager(tmp_path, steps=f'{text}method = "gradient"\n'), "steps")
    assert gradient.reflectance.path_tracing.renderer == ""


def test_one_preset_is_the_default(tmp_path: Path) -> None:
    assert load_config(PluginManager.discover()).preset == "fast"
    broken = manager(tmp_path, broken="default_preset = ")
    assert load_config(broken).preset == "fast", "a preset that is not used may be broken"
    second = manager(tmp_path, second="default_preset = true\n" + "".join(COMPLETE.values()))
    assert load_config(second, "second").preset == "second"
    with pytest.raises(ConfigError, match=r"the presets fast, second are all the default; name one with --preset"):
        load_config(second)
    with pytest.raises(ConfigError, match=r"no installed preset is the default"):
        load_config(PluginManager())
