"""Under which light an evaluation looks: the fitted one, the split's own, or one that is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import write_hdr

from hir_core.errors import InputError
from hir_core.evaluation.relighting import lit_scene
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.run.finished_run import open_finished_run

PLUGINS = PluginManager.discover()


def test_the_light_is_the_fitted_one_the_splits_or_the_named_one(
    finished: Run, tiny_capture: Path, tmp_path: Path
) -> None:
    run = open_finished_run(finished.directory)
    splits = {split: run.read_split(tiny_capture, split, PLUGINS) for split in ("test", "relight_0")}
    scene, facts = lit_scene(run, tiny_capture, splits["test"], "", PLUGINS)
    assert scene is run.scene and facts == {"fitted": True}, "the same light as in training"
    scene, facts = lit_scene(run, tiny_capture, splits["relight_0"], "", PLUGINS)
    assert scene is not run.scene and not facts["fitted"] and facts["file"].endswith(".hdr")
    write_hdr(tmp_path / "even.hdr", np.ones((4, 8, 3), np.float32))
    scene, facts = lit_scene(run, tiny_capture, splits["test"], f"{tmp_path / 'even.hdr'}*2.5", PLUGINS)
    assert facts == {"fitted": False, "file": "even.hdr", "strength": 2.5}
    assert scene.environment is not None and float((scene.environment.radiance - 2.5).abs().max()) < 0.02
    (tmp_path / "light.png").write_bytes(b"")
    with pytest.raises(InputError, match="a light must be a lat-long"):
        lit_scene(run, tiny_capture, splits["test"], str(tmp_path / "light.png"), PLUGINS)
