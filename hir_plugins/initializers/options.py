"""Options of the built-in initializers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class VisualHullOptions:
    """How the hull of the masks is carved."""

    pixels_per_voxel: float = 2.0
    """Side of a voxel in pixels of the photographs, at the object's distance."""
    max_resolution: int = 256
    """Most voxels along the longest side of the object's box, 16 to 1024."""
    tolerated_views: int = 0
    """A place is carved only when more than this many masks say that it is background."""
    min_views: int = 0
    """A place that fewer photographs show is background; 0 means half as many as show the object's best seen place."""
    drop_bad_views: bool = True
    """Leave out masks that cut away what nearly all others keep, and say which."""
    min_component: float = 0.02
    """Pieces with less than this share of the largest piece's area are dropped."""
    edge_pixels: float = 2.5
    """Length of the mesh's edges in pixels at the object's distance; 0 leaves the triangles as they were extracted."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs that see them."""


@dataclass(frozen=True)
class MeshFileOptions:
    """A mesh that already exists: a scan, a photogrammetry mesh, a model."""

    path: str = ""
    """The mesh: glTF, OBJ, PLY, STL, OFF or another format that trimesh reads; relative to the working folder or the
    capture."""
    axes: Literal["auto", "source", "world"] = "auto"
    """Axes of the file: `source`, those of the capture's own files; `world`, right-handed with +Y up, as in a run's
    results; `auto` takes glTF for `world` and all others for `source`."""
    transform: tuple[float, ...] = ()
    """A 4×4 similarity in rows (16 numbers) applied to the file's vertices first."""
    align: Literal["none", "points"] = "none"
    """`points` brings a mesh of unknown place, turn and size onto the capture's points (colmap's or stereo's)."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs where the file has no colours."""


@dataclass(frozen=True)
class ColmapOptions:
    """How cameras are found."""

    known_cameras: Literal["triangulate", "solve"] = "triangulate"
    """What becomes of a capture whose photographs all have cameras: `triangulate` keeps them and finds the points that
    they see, `solve` finds the cameras anew."""
    max_image_size: int = 1600
    """Photographs are made a whole number of times smaller until their longer side is not above this."""
    max_features: int = 4096
    """Features a photograph at the first attempt; the next ones take twice as many."""
    matching: Literal["auto", "exhaustive", "sequential", "vocabulary"] = "auto"
    """Which pairs are compared; `auto`: all pairs up to 150 photographs, above that those that a vocabulary tree,
    trained on the capture itself, finds alike. `sequential` suits a video."""
    mapper: Literal["incremental", "global"] = "incremental"
    """One photograph after the other, or all at once: faster with hundreds of them."""
    camera: Literal["auto", "single", "each"] = "auto"
    """Which photographs share a camera: those of one size, model and focal length, those of one size, or none."""
    camera_model: Literal["PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"] = "SIMPLE_RADIAL"
    """COLMAP's name of the lens that is solved."""
    focal_length: float = 0.0
    """In pixels of the photographs; 0 takes it from EXIF, or guesses 1.2 times the longer side."""
    refine_intrinsics: bool = True
    """Let focal length and lens be solved; without it they stay as given."""
    use_masks: bool = True
    """Take features from inside the masks, where there are any: the background of a turntable misleads."""
    retry: bool = True
    """Try again, harder, when the photographs fall apart into fragments."""
    enough: float = 0.9
    """Share of the photographs in one piece with which an attempt counts as good."""
    size: float = 1.0
    """Length of the object's longest side, in metres, where neither a scale bar nor the photographs' GPS tells it."""
    scale_bar: str = ""
    """A text file that marks the two ends of a known length in photographs, a line each: `photograph end x y`, such as
    `IMG_0012 a 811.5 402`; `end` is a or b, x and y pixels from the picture's left upper corner, two photographs or
    more for either end. The path is relative to the capture."""
    scale_bar_length: float = 0.0
    """Distance of the two ends in metres."""
    gps: bool = True
    """Take the scale from the photographs' GPS where it is known to 5 % from it: drones and buildings, not tables."""
    threads: int = -1
    """-1 for all."""
    seed: int = 0
    """Of the matching's random trials."""


@dataclass(frozen=True)
class StereoOptions:
    """How depth is measured and what it may change."""

    method: Literal["auto", "sweep", "patch_match"] = "auto"
    """`sweep` is ours, for any processor or GPU; `patch_match` is COLMAP's, which needs a COLMAP built with CUDA;
    `auto` prefers it. run.json says which it was."""
    max_image_size: int = 400
    """Photographs are made a whole number of times smaller until their longer side is not above this."""
    levels: int = 2
    """Coarse-to-fine levels, each twice the size of the one before; each starts from the surface of the last."""
    neighbours: int = 6
    """Photographs that each one is compared with; four more judge the result."""
    steps: int = 64
    """Most depths that the first level tries at a pixel."""
    window: int = 7
    """Side of the compared windows in pixels, odd."""
    min_views: int = 2
    """Neighbours that must confirm a depth."""
    judge: bool = True
    """Undo what was carved out of the hull where photographs do not match better along the new surface."""
    surface: Literal["auto", "hull", "poisson", "tsdf"] = "auto"
    """`hull` carves the measured depths out of the surface that an earlier initializer made, or out of the visual hull;
    `poisson` fits a closed surface to the points alone, `tsdf` an open one to the depths; `auto` takes `hull` where
    there are masks or a surface, else `poisson`."""
    pixels_per_voxel: float = 2.0
    """Side of a voxel in pixels of the photographs, at the object's distance."""
    max_resolution: int = 256
    """Most voxels along the longest side of the object's box, 16 to 1024."""
    edge_pixels: float = 2.5
    """Length of the mesh's edges in pixels at the object's distance; 0 leaves the triangles as they were extracted."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs that see them."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the sweep runs; `auto` takes a GPU where torch has one."""


@dataclass(frozen=True)
class PoissonOptions:
    """A surface through oriented points (Kazhdan & Hoppe 2013, open3d)."""

    depth: int = 0
    """Depth of the octree; 0 derives it from the number of points."""
    trim: float = 0.02
    """Share of the vertices with the fewest points around them that is cut off; 0 keeps the surface closed."""
    min_component: float = 0.05
    """Pieces with less than this share of the largest piece's area are dropped."""
    edge_pixels: float = 2.5
    """Length of the mesh's edges in pixels at the object's distance; 0 leaves the triangles as they were extracted."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs that see them."""
