"""What each study varies; cells that several studies share run once."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.experiments.cells import Cell

SIDE = 128
LIGHTER = (
    "geometry.iterations=150",
    "geometry.photo_consistency_iterations=50",
    "reflectance_renderer.transport_ggx.steps=100",
    "reflectance_renderer.transport_ggx.cache_cells=3000",
    "reflectance_renderer.transport_ggx.vertices=15000",
    "reflectance_renderer.transport_ggx.pixels=40000",
    "reflectance_renderer.transport_ggx.texture_pixels=400000",
)
"""Small photographs and fewer steps: studies of differences need many runs rather than the lowest error."""


@dataclass(frozen=True)
class Study:
    """Rows of a table of docs/studies/paper_experiments.md."""

    title: str
    text: str
    rows: tuple[tuple[str, Cell], ...]


def studied(name: str, *settings: str, capture: str = "spot", views: int = 80) -> Cell:
    """A cell of the studies of differences: `fast` with lighter settings, and what it varies."""
    splits = ("test",) if capture.startswith("made:") else ("test", "relight_0")
    return Cell(name, capture, views, SIDE, settings=(*LIGHTER, *settings), splits=splits)


def full(views: int, side: int) -> Cell:
    """A whole run of `fast` as it is."""
    return Cell(f"full_{views}_{side}", "spot", views, side, splits=(), stretched=True)


BASE = studied("spot_80")

IMAGES = Study(
    "Number of photographs",
    f"captures/spot at {SIDE}²: what fewer photographs cost. (The paper: 150 suffice, 250 match the truth.)",
    tuple((f"{n} photographs", BASE if n == 80 else studied(f"spot_{n}", views=n)) for n in (10, 20, 40, 80)),
)

TERMS = Study(
    "Each term of the loss",
    f"captures/spot, 80 photographs of {SIDE}². Each row leaves out one term of `fast`, or adds one of the paper's.",
    (
        ("all of `fast`", BASE),
        ("without bending energy", studied("no_bending", "geometry.regularizers.laplacian=false")),
        (
            "without photographs in the geometry stage",
            # iterations as in the preset: other ones would have no effect, which is refused
            studied("no_photographs", "geometry.photo_consistency='off'", "geometry.photo_consistency_iterations=100"),
        ),
        (
            "without smoothness of the light",
            studied("no_light_smoothness", "reflectance_renderer.transport_ggx.light_smoothness=0.0"),
        ),
        (
            "without whiteness of the light",
            studied("no_light_whiteness", "reflectance_renderer.transport_ggx.light_whiteness=0.0"),
        ),
        (
            "without smoothness of the albedo",
            studied("no_albedo_smoothness", "reflectance_renderer.transport_ggx.albedo_smoothness=0.0"),
        ),
        (
            "initial albedo from the photographs, shading included",
            studied("albedo_start", "reflectance_renderer.transport_ggx.initial_albedo='photographs'"),
        ),
        ("diffuse alone: no lobe", studied("diffuse", "reflectance.model='diffuse'")),
        ("a specular map", studied("specular_map", "reflectance.model='specular_map'")),
        (
            "a specular map, with the paper's bilateral term",
            studied(
                "bilateral",
                "reflectance.model='specular_map'",
                "reflectance.regularizers.bilateral_specular={weight=1.0, average=true}",
            ),
        ),
    ),
)

LIGHTS = Study(
    "A lamp on the camera, and light around",
    f"The same cow: 60 photographs of {SIDE}² that Cycles rendered with a lamp beside the lens "
    "(`tools/render_capture_in_blender.py`), and 60 of captures/spot in its hall. Held-out views choose between light "
    "in the world and light on the camera; the last row excludes the correct one.",
    (
        ("light around", studied("hall_60", views=60)),
        ("lamp on the camera", studied("flash_60", capture="made:flash", views=60)),
        (
            "lamp on the camera, light frame fixed to the world",
            studied("flash_world", "reflectance.light_frame='world'", capture="made:flash", views=60),
        ),
    ),
)

SCALING = Study(
    "Scaling",
    "Whole runs of `fast` as it is: processor seconds (those of geometry + reflectance) and peak memory by number and "
    "size of photographs, one thread, which equals wall-clock time on an idle machine. "
    "captures/spot has 80 photographs of 512²: more photographs are repetitions, larger ones are enlarged.",
    tuple((f"{views} × {side}²", full(views, side)) for views in (20, 80, 300) for side in (256, 512, 1024)),
)

PAPER_STEPS = Cell(
    "paper_steps",
    "spot",
    80,
    512,
    "paper",
    (
        "geometry.iterations_per_view=0",
        "geometry.iterations=4",
        "reflectance.gradient.iterations_per_view=0",
        "reflectance.gradient.iterations=12",
    ),
    (),
)
"""A few steps of the paper's two stages; the time of all steps is extrapolated from them."""

BEST = Cell("best_spot", "spot", 80, 512, "best", evaluated=0)
"""A whole run, evaluated on all views like those of `tools/write_benchmarks.py` are."""

PRESETS = Study(
    "The paper's table, in our rows",
    "Whole runs that `tools/write_benchmarks.py --runs` gathered, `best` on one capture, and a few steps of the "
    "paper's recipe.",
    (("`paper`, a few steps", PAPER_STEPS), ("`best`: spot", BEST)),
)

STUDIES = {"images": IMAGES, "terms": TERMS, "lights": LIGHTS, "paper-table": PRESETS, "scaling": SCALING}
