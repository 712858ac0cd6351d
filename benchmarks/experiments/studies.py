"""What is varied in each study; cells that several studies share are run once."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.experiments.cells import Cell

BASE = Cell("spot_80_256", "spot")


@dataclass(frozen=True)
class Study:
    """Rows of a table of docs/experiments.md."""

    title: str
    text: str
    rows: tuple[tuple[str, Cell], ...]


def base(views: int = 80, side: int = 256) -> Cell:
    """captures/spot with other sizes."""
    return Cell(f"spot_{views}_{side}", "spot", views, side)


def varied(name: str, *settings: str) -> Cell:
    """The base with other settings."""
    return Cell(f"spot_{name}", "spot", settings=settings)


IMAGES = Study(
    "Number of photographs",
    "captures/spot at 256², preset `fast`: what fewer photographs cost. (The paper: 150 suffice, 250 match the truth.)",
    tuple((f"{views} photographs", base(views)) for views in (10, 20, 40, 80)),
)

TERMS = Study(
    "Each term of the loss",
    "captures/spot, 80 photographs of 256². Each row leaves out one term of `fast`, or adds one of the paper's.",
    (
        ("all of `fast`", BASE),
        ("without bending energy", varied("no_bending", "geometry.regularizers.laplacian=false")),
        ("without photographs in the geometry stage", varied("no_photographs", "geometry.photographs='off'")),
        ("without smoothness of the light", varied("no_light_smoothness",
                                                   "reflectance_renderer.transport_ggx.light_smoothness=0.0")),
        ("without whiteness of the light", varied("no_light_whiteness",
                                                  "reflectance_renderer.transport_ggx.light_whiteness=0.0")),
        ("diffuse alone: no lobe", varied("diffuse", "reflectance.model='diffuse'")),
        ("a specular map", varied("specular_map", "reflectance.model='specular_map'")),
        ("a specular map, with the paper's bilateral term",
         varied("bilateral", "reflectance.model='specular_map'",
                "reflectance.regularizers.bilateral_specular={weight=1.0, average=true, neighbours=32}")),
    ),
)  # fmt: skip

LIGHTS = Study(
    "A lamp on the camera, and light around",
    "The same cow, 60 photographs of 256² by Cycles (`tools/render_capture_in_blender.py`) with a lamp beside the lens, against captures/spot's hall "
    "thinned to as many. Held-out views choose between light in the world and light on the camera; the last row forbids the right one.",
    (
        ("light around", Cell("spot_60_256", "spot", 60)),
        ("lamp on the camera", Cell("flash_60_256", "made:flash", 60, splits=("test",))),
        ("lamp on the camera, light held in the world",
         Cell("flash_world", "made:flash", 60, settings=("reflectance.light_frame='world'",), splits=("test",))),
    ),
)  # fmt: skip

SCALING = Study(
    "Scaling",
    "Whole runs, preset `fast`. 300 photographs: by Cycles, as above.",
    tuple(
        (f"{views} × {side}²", Cell("many_300_256", "made:many", 300, splits=("test",)) if views == 300 and side == 256
         else Cell(f"many_300_{side}", f"made:many_{side}", 300, side, splits=("test",)) if views == 300
         else Cell(f"large_{views}_{side}", f"made:large_{side}", views, side, splits=("test",)) if side > 512
         else base(views, side))
        for views in (20, 80, 300) for side in (256, 512, 1024)
    ),
)  # fmt: skip

PRESETS = Study(
    "The paper's table, in our rows",
    "captures/spot, 80 photographs of 512², unseen views.",
    (("fast", base(80, 512)),),
)

STUDIES = {"images": IMAGES, "terms": TERMS, "lights": LIGHTS, "scaling": SCALING, "paper-table": PRESETS}
