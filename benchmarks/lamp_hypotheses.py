"""Whether the simplest hypothesis with a lamp is ahead in a short fit: made photographs with a flash and without.

`python -m benchmarks.lamp_hypotheses` prints the table of docs/studies/lamp_hypotheses.md; `--store FILE` appends its
rows as lines of JSON, with commit, date and machine.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.stored_rows import add_rows, provenance
from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.scene import CameraLamp, EnvironmentMap, Material, Scene
from hir_core.stages.held_out_views import model_selection_folds
from hir_core.stages.reflectance.initial_material_and_light import initial_scene
from hir_core.stages.reflectance.selection.exposure_selection import BUDGET
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.folded_fits import FoldedFits
from hir_core.stages.reflectance.selection.held_out_comparison import paired_gain
from hir_core.stages.reflectance.selection.hypotheses import LIGHTS, hypothesis
from hir_core.stages.reflectance.selection.lamp_selection import is_ahead_of
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.made_captures import around, ball, lamps, make_material, painted, photographs, sky

VIEWS, SIZE = 30, 32
DISTANCE = 0.8
"""Of the nearest camera, as a share of the fixture's."""
RATIOS = (1.0, 2.0)
"""The farthest camera's distance over the nearest one's."""
FLASH = CameraLamp(torch.tensor([12.0, 11.0, 9.0]), torch.tensor([0.3, -0.6, 0.0]), torch.tensor(2.0))


def lights() -> dict[str, EnvironmentMap]:
    """By name; the first two have a flash."""
    return {
        "flash in a dim room": EnvironmentMap(sky().radiance * 0.3, lamp=FLASH),
        "flash in a dark room": EnvironmentMap(sky().radiance * 0.05, lamp=FLASH),
        "sky": sky(),
        "two lamps": lamps(),
        "turntable": EnvironmentMap(lamps().radiance, None, "camera"),
    }


def painted_texture() -> torch.Tensor:
    """Smooth patterns of all three colours."""
    frequency, phase = torch.tensor([3.0, 4.0, 5.0]), torch.tensor([0.0, 1.0, 2.0])
    return painted(ball(), lambda position: 0.5 + 0.35 * torch.sin(position * frequency + phase))[0]


def materials() -> dict[str, Material]:
    """A matt, a glossy and a metallic one."""
    texture = painted_texture()
    return {
        "diffuse": make_material(texture, 0.0, 0.3, "paper"),
        "dielectric": make_material(texture, 0.04, 0.15, "dielectric"),
        "metal": Material.metallic(torch.tensor([0.9, 0.7, 0.4]), torch.tensor([1.0]), torch.tensor([0.25])),
    }


def made(material: Material, light: EnvironmentMap, ratio: float) -> Capture:
    """Photographs from distances that differ by up to `ratio`."""
    distances = DISTANCE * ratio ** ((np.arange(VIEWS) * 0.754878) % 1)
    eyes = [tuple(np.array(eye) * distance) for eye, distance in zip(around(VIEWS), distances, strict=True)]
    return photographs(Scene(ball(), material, light), eyes, 2, SIZE)


def row(light: str, material: str, ratio: float) -> dict[str, Any]:
    """Held-out dB of the diffuse hypothesis under each light, and whether hypotheses with a lamp take part."""
    capture = made(materials()[material], lights()[light], ratio)
    options = TransportGGXOptions(vertices=0, cache_cells=800, steps=200)
    solver = TransportGGX(options).prepare(initial(capture), capture)
    folds = FoldedFits(FitSequence(solver, lambda name, share: None), model_selection_folds(VIEWS))
    fits = {each: folds.fit(hypothesis("diffuse", each), None, BUDGET.effort, BUDGET.pixel_share) for each in LIGHTS}
    gains = {each: paired_gain(fits[each].errors, fits["lamp"].errors) for each in LIGHTS if each != "lamp"}
    return {
        "light": light,
        "material": material,
        "distances": ratio,
        "held_out_db": {name: round(fit.held_out_db, 2) for name, fit in fits.items()},
        "lead_db": {name: [round(value, 2) for value in gain] for name, gain in gains.items()},
        "takes_part": is_ahead_of(fits["lamp"], [fit for name, fit in fits.items() if name != "lamp"]),
        **provenance(),
    }


def initial(capture: Capture) -> Scene:
    """The scene that a run starts from."""
    grey = Material("dielectric", torch.full((64, 64, 3), 0.5), torch.full((3,), 0.04), torch.tensor([0.15]))
    settings = ReflectanceSettings(environment_height=16, environment_width=32)
    return initial_scene(Scene(ball(), grey, None), capture, settings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, help="append rows to this file")
    given = parser.parse_args()
    torch.set_num_threads(1)
    print("| light | material | distances | world | camera | lamp | lead over world | over camera | takes part |")
    print("|---|---|---|---|---|---|---|---|---|")
    for ratio in RATIOS:
        for material in materials():
            for light in lights():
                found = row(light, material, ratio)
                if given.store is not None:
                    add_rows(given.store, [found])
                values = [f"{found['held_out_db'][each]:.1f}" for each in LIGHTS]
                leads = ["{:+.1f} ± {:.1f}".format(*found["lead_db"][each]) for each in LIGHTS if each != "lamp"]
                yes = "yes" if found["takes_part"] else "no"
                print(f"| {light} | {material} | {ratio} | {' | '.join([*values, *leads])} | {yes} |", flush=True)


if __name__ == "__main__":
    main()
