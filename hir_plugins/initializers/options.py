"""Options of the built-in initializers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, Unit

from hir_core.plugins.options import device_of_run, seed_of_run


@dataclass(frozen=True)
class VisualHullOptions:
    """Options of the visual hull."""

    pixels_per_voxel: Annotated[float, Interval(gt=0), Unit("pixels")] = 2.0
    """Side of a voxel, in pixels of the photographs at the object's distance."""
    max_resolution: Annotated[int, Interval(ge=16, le=1024), Unit("voxels")] = 256
    """Maximum number of voxels along the longest side of the object's box."""
    tolerated_views: Annotated[int, Interval(ge=0)] = 0
    """A point is carved away only when more than this many masks show background there."""
    min_views: Annotated[int, Interval(ge=0)] = 0
    """Points in fewer photographs than this are background; 0 means half of the largest number of photographs that show
    any point of the object."""
    drop_bad_views: bool = True
    """Do not use masks that contradict nearly all others. A warning names them."""
    min_component: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """Connected components with less than this share of the largest component's area are removed."""
    edge_pixels: Annotated[float, Interval(ge=0), Unit("pixels")] = 2.5
    """Edge length of the mesh, in pixels at the object's distance; 0 keeps the extracted triangles."""
    unseen_surface: Literal["membrane", "hull"] = "membrane"
    """Surface that no photograph shows. `membrane` spans it between surface that photographs show, where the hull has
    an edge between the two: an object on a table gets a flat base. `hull` keeps the cone in which a hull ends there."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs in which they are visible."""
    seed: int = seed_of_run()
    """Seed of the order in which remeshing collapses short edges; the run's, unless it is set."""


@dataclass(frozen=True)
class CameraRefinementOptions:
    """Options of the refinement of given cameras."""

    when: Literal["auto", "always", "never"] = "auto"
    """`auto`: where the masks disagree with the visual hull of other masks. `always`: whatever they say. Refined
    cameras are used only where held-out views agree better. `never` keeps the given cameras."""
    method: Literal["auto", "silhouettes", "bundle_adjustment"] = "auto"
    """`silhouettes` moves each camera until the outline of its mask fits the hull of the others: it needs no texture.
    `bundle_adjustment` matches features of the photographs: more accurate on textured objects, useless on metal and
    plain ones. `auto` adjusts from the poses of the silhouettes, and decides by held-out feature tracks."""
    focal_length: Literal["auto", "keep"] = "auto"
    """`auto` lets bundle adjustment change the focal length where that lowers the error of held-out tracks."""
    max_gap: Annotated[float, Interval(gt=0), Unit("pixels")] = 0.5
    """Cameras are refined where the median gap between a mask's outline and the hull of other masks is larger, in
    pixels of masks reduced to 256 to 511 pixels on the longer side."""
    rounds: Annotated[int, Interval(ge=1, le=100)] = 6
    """How many times the hull and all poses are fitted to each other in turn."""
    max_image_size: Annotated[int, Interval(ge=64), Unit("pixels")] = 1600
    """For features, photographs are reduced by a whole factor until their longer side is at most this."""
    threads: Annotated[int, Interval(ge=-1)] = -1
    """Of feature matching and bundle adjustment; -1 uses all."""
    seed: int = seed_of_run()
    """Seed of the random trials of matching; the run's, unless it is set."""


@dataclass(frozen=True)
class SensorDepthOptions:
    """Options of the visual hull that is carved by measured depths."""

    min_weight: Annotated[float, Interval(gt=0)] = 0.9
    """A point keeps the distance of the hull where the confidences of the depths that concern it sum up to less: one
    depth of full confidence carves, of medium confidence two."""
    pixels_per_voxel: Annotated[float, Interval(gt=0), Unit("pixels")] = 2.0
    """Side of a voxel, in pixels of the photographs at the object's distance."""
    max_resolution: Annotated[int, Interval(ge=16, le=1024), Unit("voxels")] = 256
    """Maximum number of voxels along the longest side of the object's box."""
    edge_pixels: Annotated[float, Interval(ge=0), Unit("pixels")] = 2.5
    """Edge length of the mesh, in pixels at the object's distance; 0 keeps the extracted triangles."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs in which they are visible."""
    seed: int = seed_of_run()
    """Seed of the order in which remeshing collapses short edges; the run's, unless it is set."""


@dataclass(frozen=True)
class MeshFileOptions:
    """Options of a mesh that already exists: a scan, a photogrammetry mesh, a model."""

    path: str = ""
    """File of the mesh: glTF, OBJ, PLY, STL, OFF or another format that trimesh reads; relative to the working folder
    or to the capture."""
    axes: Literal["auto", "source", "source_y_up", "world"] = "auto"
    """Axes of the file. `source`: the axes of the capture's own files. `source_y_up`: those of a capture that is +Z up,
    turned to +Y up, as programs write glTF. `world`: right-handed with +Y up, as in a run's results. `auto`: `source`;
    for glTF the one of the three in which the photographs agree best about the colours of the mesh."""
    transform: tuple[float, ...] = ()
    """A 4×4 similarity transform in row order (16 numbers), applied to the file's vertices first."""
    align: Literal["none", "points"] = "none"
    """`points` aligns a mesh of unknown position, rotation and scale with the capture's points (from colmap or
    stereo)."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs if the file has no colours."""
    seed: int = seed_of_run()
    """Seed of the points that the alignment samples; the run's, unless it is set."""


@dataclass(frozen=True)
class ColmapOptions:
    """Options of structure from motion."""

    known_cameras: Literal["triangulate", "solve"] = "triangulate"
    """For a capture whose photographs all have cameras: `triangulate` keeps the cameras and triangulates points,
    `solve` estimates new cameras."""
    max_image_size: Annotated[int, Interval(ge=64), Unit("pixels")] = 1600
    """Photographs are reduced by a whole factor until their longer side is at most this, in pixels."""
    max_features: Annotated[int, Interval(ge=1)] = 4096
    """Features per photograph in the first attempt; later attempts use twice as many."""
    matching: Literal["auto", "exhaustive", "sequential", "vocabulary"] = "auto"
    """Which pairs of photographs are matched. `auto`: all pairs up to 150 photographs (300 of several takes), above
    that the pairs that a vocabulary tree, trained on the capture itself, finds similar. `sequential` suits a video."""
    mapper: Literal["incremental", "global"] = "incremental"
    """`incremental` registers one photograph after the other, `global` all at once: faster for hundreds of them."""
    camera: Literal["auto", "single", "each"] = "auto"
    """Which photographs share intrinsics. `auto`: those of one size, model and focal length. `single`: those of one
    size. `each`: none."""
    camera_model: Literal["PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"] = "SIMPLE_RADIAL"
    """COLMAP's name of the lens model to estimate. The distortion of `SIMPLE_RADIAL` is left out where it does not
    lower the reprojection error: it would be compensated by a wrong focal length."""
    focal_length: Annotated[float, Interval(ge=0), Unit("pixels")] = 0.0
    """In pixels of the photographs; 0 takes it from EXIF, or assumes 1.2 times the longer side."""
    refine_intrinsics: bool = True
    """Estimate the focal length and the lens; otherwise the initial values are kept."""
    use_masks: bool = True
    """Use only features inside the masks, if there are masks: the static background of a turntable misleads."""
    retry: bool = True
    """Try again with more features if the photographs do not register in one model."""
    min_registered_share: Annotated[float, Interval(ge=0, le=1)] = 0.9
    """Share of the photographs in one model above which no further attempt is made."""
    object_size: Annotated[float, Interval(gt=0), Unit("m")] = 1.0
    """Length of the object's longest side in metres, used if neither a scale bar nor GPS gives the scale."""
    scale_bar: str = ""
    """A text file that marks both ends of a known length in photographs, one line `photograph end x y` per mark, such
    as `IMG_0012 a 811.5 402`. `end` is a or b; x and y are pixels from the upper left corner. Each end needs marks in
    at least two photographs. The path is relative to the capture."""
    scale_bar_length: Annotated[float, Interval(ge=0), Unit("m")] = 0.0
    """Distance between the two ends in metres."""
    gps: bool = True
    """Take the scale from the GPS positions of the photographs if its standard error is at most 5 %: true for drones
    and buildings, not for tables."""
    threads: Annotated[int, Interval(ge=-1)] = -1
    """-1 uses all."""
    seed: int = seed_of_run()
    """Seed of the random trials of matching, mapping and scale; the run's, unless it is set."""


@dataclass(frozen=True)
class FiducialMarkersOptions:
    """Options of printed markers of known size."""

    side: Annotated[float, Interval(ge=0), Unit("m")] = 0.0
    """Side of a marker's black square in metres; all markers have the same. Required."""
    dictionary: Literal[
        "auto",
        "aruco_4x4",
        "aruco_5x5",
        "aruco_6x6",
        "aruco_7x7",
        "aruco_original",
        "apriltag_16h5",
        "apriltag_25h9",
        "apriltag_36h10",
        "apriltag_36h11",
    ] = "auto"
    """Which set the markers are from; `auto` tries all on twelve photographs."""
    level: bool = True
    """Turn the world so that the table on which the markers lie is horizontal. Not done where they do not lie in one
    plane, or where that is more than 45 degrees from the horizontal."""
    paper_reflectance: Annotated[float, Interval(ge=0, le=1)] = 0.85
    """Of the bare paper of a card from `hir card`, 0.02 to 1: it gives the scale between albedo and light, and their
    colour. 0 takes no brightness from the card. Office paper has 0.8 to 0.9."""


@dataclass(frozen=True)
class ColorCheckerOptions:
    """Options of a ColorChecker beside the object."""

    reflectance_factor: Annotated[float, Interval(ge=0.5, le=1.5)] = 1.0
    """Multiplies the known reflectances of the greys: below 1 for a chart that is dirty or faded."""


@dataclass(frozen=True)
class StereoOptions:
    """Options of multi-view stereo."""

    method: Literal["auto", "sweep", "patch_match"] = "auto"
    """`sweep` is our own, for any processor or GPU. `patch_match` is COLMAP's and needs a COLMAP built with CUDA.
    `auto` prefers `patch_match`. run.json records which was used."""
    max_image_size: Annotated[int, Interval(ge=32), Unit("pixels")] = 400
    """Photographs are reduced by a whole factor until their longer side is at most this, in pixels."""
    max_photographs: Annotated[int, Interval(ge=2)] = 48
    """At most this many photographs are used, those whose directions cover the others' best: time grows with them. Each
    take has a share in proportion to its photographs."""
    levels: Annotated[int, Interval(ge=1, le=6)] = 2
    """Number of coarse-to-fine levels. Each doubles the resolution and starts from the surface of the previous one."""
    neighbours: Annotated[int, Interval(ge=1)] = 6
    """Number of photographs of its take that each one is compared with; four more verify the result."""
    steps: Annotated[int, Interval(ge=4)] = 64
    """Maximum number of depth hypotheses per pixel at the first level."""
    window: Annotated[int, Interval(ge=3), Unit("pixels")] = 7
    """Side of the compared windows in pixels, odd."""
    min_views: Annotated[int, Interval(ge=1)] = 2
    """Number of neighbours that must confirm a depth."""
    verify_carving: bool = True
    """Undo the carving where the photographs do not match better along the carved surface, and where its brightness
    changes with the direction, as on metal: reflections look like a surface behind the real one."""
    surface: Literal["auto", "hull", "poisson", "tsdf"] = "auto"
    """`hull` carves the measured depths out of the surface of an earlier initializer, or out of the visual hull.
    `poisson` fits a closed surface to the points, `tsdf` an open one to the depths. `auto`: `hull` if there are masks
    or a surface, else `poisson`."""
    pixels_per_voxel: Annotated[float, Interval(gt=0), Unit("pixels")] = 2.0
    """Side of a voxel, in pixels of the photographs at the object's distance."""
    max_resolution: Annotated[int, Interval(ge=16, le=1024), Unit("voxels")] = 256
    """Maximum number of voxels along the longest side of the object's box."""
    edge_pixels: Annotated[float, Interval(ge=0), Unit("pixels")] = 2.5
    """Edge length of the mesh, in pixels at the object's distance; 0 keeps the extracted triangles."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs in which they are visible."""
    seed: int = seed_of_run()
    """Seed of the order in which remeshing collapses short edges; the run's, unless it is set."""
    device: Literal["auto", "cpu", "cuda"] = device_of_run()
    """Device of the sweep: the run's, unless it is set. `auto` uses CUDA if there is a device."""


@dataclass(frozen=True)
class HollowsOptions:
    """Options of the search for hollows."""

    max_hollows: Annotated[int, Interval(ge=0)] = 8
    """At most this many openings are sunk, the one that explains most first; 0 looks for none."""
    max_photographs: Annotated[int, Interval(ge=6)] = 64
    """At most this many photographs are compared, those whose directions cover the others' best: time grows with them.
    Each take has a share in proportion to its photographs."""
    pixels_per_voxel: Annotated[float, Interval(gt=0), Unit("pixels")] = 2.0
    """Side of a voxel of the result, in pixels of the photographs at the object's distance."""
    max_resolution: Annotated[int, Interval(ge=16, le=1024), Unit("voxels")] = 256
    """Maximum number of voxels along the longest side of the object's box."""
    edge_pixels: Annotated[float, Interval(ge=0), Unit("pixels")] = 2.5
    """Edge length of the mesh, in pixels at the object's distance; 0 keeps the extracted triangles."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs in which they are visible."""
    seed: int = seed_of_run()
    """Seed of the choice of pixels, and of the order in which remeshing collapses short edges; the run's, unless it is
    set."""


@dataclass(frozen=True)
class PoissonOptions:
    """Options of screened Poisson reconstruction (Kazhdan & Hoppe 2013, open3d)."""

    depth: Annotated[int, Interval(ge=0, le=16)] = 0
    """Depth of the octree; 0 derives it from the number of points."""
    trim: Annotated[float, Interval(ge=0, lt=1)] = 0.02
    """Share of the vertices to remove, those with the lowest point density; 0 keeps the surface closed."""
    min_component: Annotated[float, Interval(ge=0, le=1)] = 0.05
    """Connected components with less than this share of the largest component's area are removed."""
    edge_pixels: Annotated[float, Interval(ge=0), Unit("pixels")] = 2.5
    """Edge length of the mesh, in pixels at the object's distance; 0 keeps the extracted triangles."""
    vertex_colors: bool = True
    """Colour the vertices from the photographs in which they are visible."""
    seed: int = seed_of_run()
    """Seed of the order in which remeshing collapses short edges; the run's, unless it is set."""
