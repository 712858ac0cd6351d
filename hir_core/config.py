"""The settings of a run: presets, TOML files and `--set`, merged in that order and checked."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from annotated_types import Interval
from hir_exporters.files.regular_files import refuse_special_file

from hir_core.errors import ConfigError, InputError
from hir_core.plugins.options import MAX_SEED, build_options

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

Tables = dict[str, dict[str, Any]]
"""Options of components, keyed by component."""


MAX_SETTINGS_BYTES = 1 << 20
MAX_SETTINGS_DOTS = 5_000
"""In a file of settings: a key of many parts takes time and memory that grow with their square."""
MAX_SETTINGS_DEPTH = 32
"""Settings are a few tables deep; a far deeper file would exceed Python's recursion limit."""


DEFAULT_PRESET = "default_preset"
"""Key of a preset's file: `true` in the preset that is used where none is named."""


@dataclass(frozen=True)
class TermWeight:
    """What the table of a regularizer holds beside the term's own options."""

    weight: Annotated[float, Interval(ge=0)] = 1.0
    """Factor of the term in the loss; 0 leaves the term out."""


@dataclass(frozen=True)
class GeometrySettings:
    """How the mesh is fitted to the masks."""

    renderer: str = ""
    """Geometry renderer; presets set it."""
    regularizers: dict[str, dict[str, Any] | Literal[False]] = field(default_factory=dict)
    """Weight and options of each term, `false` to leave one out."""
    downsample: Annotated[int, Interval(ge=1, le=64)] = 1
    """The masks are used at 1/`downsample` of their resolution."""
    iterations: Annotated[int, Interval(ge=0)] = 400
    """Optimisation steps at each level."""
    iterations_per_view: Annotated[int, Interval(ge=0)] = 0
    """When set, replaces `iterations` by this many for each view (the paper: 200)."""
    views_per_step: Annotated[int, Interval(ge=1)] = 8
    learning_rate: Annotated[float, Interval(gt=0)] = 0.03
    """Step size as a fraction of the object's radius."""
    learning_rate_end: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """Factor by which the rate has fallen at the end of each level (cosine)."""
    parameterization: Literal["vertices", "large_steps"] = "large_steps"
    """What Adam moves: vertex positions, or their LargeSteps preconditioning (Nicolet et al. 2021)."""
    smoothness: Annotated[float, Interval(ge=0)] = 19.0
    """LargeSteps: λ of (I + λL)."""
    remesh: bool = True
    """Go from coarse to fine with isotropic remeshing between levels."""
    levels: Annotated[int, Interval(ge=0, le=8)] = 0
    """Number of resolutions with `remesh`; 3 fits meshes with a sixteenth, a quarter and all of the triangles. 0
    chooses 1 where the start's silhouettes are near the masks, else 3."""
    triangles: Annotated[int, Interval(ge=0)] = 0
    """Target number of triangles; 0 derives it from the images' resolution."""
    held_out: Annotated[float, Interval(ge=0, le=1)] = 0.08
    """Fraction of the train views that are held out; none with fewer than ten views. Six or more choose the state."""
    prune: bool = True
    """Remove floating components of the start mesh that no mask needs."""
    robust: bool = True
    """Give views a lower weight where their masks contradict the others, and name them (robust view weights)."""
    photo_consistency: Literal["auto", "off"] = "auto"
    """After the silhouettes, move vertices to make the photographs consistent, as far as views that take no part in the
    fit become more consistent, too. The reflectance stage undoes it where its held-out views are better without it."""
    photo_consistency_iterations: Annotated[int, Interval(ge=0)] = 100
    """Optimisation steps of photo-consistency at each image resolution; the second, finer attempt takes as many at each
    but the coarsest, and a last pass takes half as many."""
    occlusion_boundary_iterations: Annotated[int, Interval(ge=0)] = 200
    """After photo-consistency, steps that move the boundaries where one part of the object hides another, such as the
    rim of a vessel, to where the photographs show them; as far as views that take no part confirm it. 0 leaves them."""
    outline_iterations: Annotated[int, Interval(ge=0)] = 200
    """Steps that fit the silhouettes without regularizers, after the levels and again after photo-consistency; as far
    as views that take no part confirm it. 0 leaves outlines where regularizers and photographs moved them."""
    depth_weight: Annotated[float, Interval(ge=0)] = 10.0
    """Weight of the depths that a sensor measured, where the capture has them: they hold the surface where no outline
    does. 0 leaves them out of this stage."""
    start_radius: Annotated[float, Interval(ge=0)] = 0.0
    """Scale the start mesh to this radius during the stage and back after it; 0: no scaling."""
    enabled: bool = True


@dataclass(frozen=True)
class DepthMapSettings:
    """How depths that a sensor measured are read; both the first mesh and the geometry stage use them."""

    min_confidence: Annotated[float, Interval(ge=0, le=1)] = 0.25
    """Depths of a lower confidence are ignored; the low level of ARKit is 0, its medium level 0.5."""
    scale: Literal["auto", "as_measured"] = "auto"
    """`auto` multiplies all depths by the factor that masks and cameras determine, where they do; `as_measured` does
    not."""


@dataclass(frozen=True)
class AtlasSettings:
    """How the mesh is unwrapped."""

    texture_size: Annotated[int, Interval(ge=0, le=16384)] = 0
    """Side of the square textures; 0 derives it from the pixels that see the surface."""
    padding: Annotated[int, Interval(ge=0, le=64)] = 4
    """Texels between charts."""
    texture_coordinates: Literal["auto", "keep"] = "auto"
    """`auto` keeps those that the mesh has if they lie in 0…1 and do not overlap, and makes new ones otherwise. `keep`
    is an error where they cannot be kept."""


ModelName: TypeAlias = Literal[
    "auto", "diffuse", "specular", "specular_map", "roughness_map", "normal_map", "per_texel_brdf"
]
"""The reflectance model that is fitted; `auto` selects it on held-out views."""


@dataclass(frozen=True)
class GradientSettings:
    """Gradient steps on textures and light: `reflectance.method = "gradient"`, or after a solver that takes no
    regularizers."""

    iterations: Annotated[int, Interval(ge=0)] = 300
    """Steps. After a solver they run only where `reflectance.regularizers` names a term that it does not take."""
    iterations_per_view: Annotated[int, Interval(ge=0)] = 0
    """When set, replaces `iterations` by this many for each view (the paper: 400)."""
    learning_rate: Annotated[float, Interval(gt=0)] = 0.02
    """Of Adam."""
    learning_rate_end: Annotated[float, Interval(ge=0, le=1)] = 1.0
    """Factor by which the rate has fallen at the end (cosine)."""
    batch: Literal["pixels", "views"] = "pixels"
    """Pixels of a step: random ones of all views, or one whole view."""
    batch_pixels: Annotated[int, Interval(ge=1)] = 16384
    """Pixels of a step, where `batch` is `pixels`."""
    rgb_weight: Annotated[float, Interval(ge=0)] = 1.0
    """Weight of the photometric term."""
    loss_space: Literal["linear", "srgb"] = "srgb"
    """Space in which fit and photograph are compared."""
    initial_diffuse_albedo: Annotated[float, Interval(ge=0, le=1)] = 0.5
    """Of every texel, with `reflectance.method = "gradient"`."""


@dataclass(frozen=True)
class PathTracingSettings:
    """Path-traced refinement after the renderer's solver, accepted only where held-out views gain."""

    renderer: str = ""
    """Reflectance renderer of the refinement; presets set it."""
    refine_albedo: bool = True
    """Solve the diffuse albedo once more, in closed form, under path-traced radiance."""
    iterations: Annotated[int, Interval(ge=0)] = 0
    """Gradient steps through the path tracer; 0 for none."""
    learning_rate: Annotated[float, Interval(gt=0)] = 0.003
    """Of these steps; it falls to a tenth."""


@dataclass(frozen=True)
class ReflectanceSettings:
    """How material and light are fitted."""

    renderer: str = ""
    """Reflectance renderer of the fit; presets set it."""
    method: Literal["auto", "solver", "gradient"] = "auto"
    """`solver`: the renderer's own solver. `gradient`: gradient steps through any renderer. `auto`: the solver where
    the renderer has one."""
    model: ModelName = "auto"
    """`auto` selects the model on held-out views; any other is fitted without a comparison."""
    brdf: Literal["auto", "paper", "dielectric", "metallic"] = "auto"
    """BRDF of the models with a specular lobe; `auto` compares all but `paper`, and a diffuse model, where the model is
    selected, and is `dielectric` elsewhere. `metallic` is glTF's own model."""
    metalness: Literal["auto", "metal", "map"] = "auto"
    """Of the BRDF `metallic`: `metal` is metal everywhere, `map` is metal in some places and dielectric in others.
    `auto` compares both where the model is selected, and is `map` elsewhere."""
    regularizers: dict[str, dict[str, Any] | Literal[False]] = field(default_factory=dict)
    """Weight and options of each term, `false` to leave one out."""
    downsample: Annotated[int, Interval(ge=1, le=64)] = 1
    """Photographs are used at 1/`downsample` of their resolution."""
    environment_height: Annotated[int, Interval(ge=2, le=8192)] = 64
    """Rows of the light's lat-long image."""
    environment_width: Annotated[int, Interval(ge=2, le=8192)] = 128
    """Columns of the light's image."""
    initial_radiance: Annotated[float, Interval(gt=0)] | Literal["auto"] = "auto"
    """Of every texel of the light. `auto`: as bright as shows an albedo of 0.3 in the mean colour of the photographs;
    0.5 where the renderer has no solver."""
    initial_roughness: Annotated[float, Interval(ge=0, le=1)] = 0.15
    """GGX width α."""
    initial_specular_albedo: Annotated[float, Interval(ge=0, le=1)] = 0.04
    """ρs."""
    light_frame: Literal["auto", "world", "camera", "lamp"] = "auto"
    """Whether the light is fixed in the world or moves with the camera as a whole (turntable), or the camera carries a
    small `lamp` (flash) beside a light that is fixed in the world."""
    exposures: Literal["auto", "equal", "recorded", "fitted"] = "auto"
    """Whether all photographs have one exposure, those that their EXIF data record, or a brightness and white balance
    of their own that are fitted; `auto` compares them on held-out views."""
    conserve_energy: bool = True
    """No texel reflects more light than it receives: ρd + ρs ≤ 1 in the `paper` model, each ≤ 1 in `dielectric`."""
    known_environment: str = ""
    """A lat-long file that is the light, `FILE` or `FILE*STRENGTH`, which is then not fitted. It is in the axes of the
    light that the capture names, or in those of the capture's files where it names none."""
    revise_mesh: bool = True
    """What initializers such as `hollows` change in the mesh is compared with the mesh without it on held-out views.
    After the fit they revise the mesh with the fitted material and light; a changed mesh is fitted again, and kept
    where held-out views gain."""
    map_errors: bool = True
    """Estimate standard errors of base colour, metalness and roughness from the spread over photographs."""
    gradient: GradientSettings = field(default_factory=GradientSettings)
    path_tracing: PathTracingSettings = field(default_factory=PathTracingSettings)
    enabled: bool = True


@dataclass(frozen=True)
class RunConfig:
    """All settings of a run; `hir config show` prints them."""

    preset: str = ""
    """The preset below the other settings; by default the one that says `default_preset = true`."""
    initializers: tuple[str, ...] | Literal["auto"] = "auto"
    """The chain that finds cameras, points and a surface."""
    masks: tuple[str, ...] | Literal["auto"] = "auto"
    """Mask sources, in the order in which they are used."""
    reader: str = "auto"
    """The capture reader; `auto` takes the first that recognises the capture."""
    initializer: Tables = field(default_factory=dict)
    """Options of each initializer."""
    mask_source: Tables = field(default_factory=dict)
    """Options of each mask source."""
    geometry_renderer: Tables = field(default_factory=dict)
    """Options of each geometry renderer."""
    reflectance_renderer: Tables = field(default_factory=dict)
    """Options of each reflectance renderer."""
    exporter: Tables = field(default_factory=dict)
    """Options of each export format."""
    depth_maps: DepthMapSettings = field(default_factory=DepthMapSettings)
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    atlas: AtlasSettings = field(default_factory=AtlasSettings)
    reflectance: ReflectanceSettings = field(default_factory=ReflectanceSettings)
    export: tuple[str, ...] = ()
    """Formats that the run writes."""
    device: str = "auto"
    """`cpu`, `cuda`, or `auto`: `cuda` if there is a CUDA device."""
    seed: Annotated[int, Interval(ge=0, le=MAX_SEED)] = 0
    """Seed of all random numbers: another one gives another result of the same expected quality."""
    deterministic: bool = False
    """Reproduce files bit for bit for the same input, seed and machine; slower, partly on one thread."""
    max_memory: str = ""
    """Memory limit, such as `4GB`. Caches and batches are reduced to keep it; a run that cannot keep it is refused
    before it starts. Empty: no limit."""
    checkpoint_seconds: Annotated[float, Interval(ge=0)] = 30.0
    """Seconds between checkpoints of a running stage; a resumed run continues from the last one."""
    report_side: Annotated[int, Interval(ge=64, le=16384)] = 1024
    """Photographs of the report with at least twice as many pixels per side are reduced, to no less than this."""
    observers: dict[str, dict[str, Any] | Literal[False]] = field(default_factory=dict)
    """Options of each observer; a table, even an empty one, enables its observer."""
    plugins: tuple[str, ...] = ()
    """Plugin files or modules in addition to the installed ones. Set on the command line only, by `--plugin`: their
    code is executed."""


def load_config(
    plugins: PluginManager,
    /,
    preset: str = "",
    file: Path | None = None,
    assignments: Sequence[str] = (),
    **overrides: Any,
) -> RunConfig:
    """Merges preset, TOML file, `--set key=value` and keyword overrides, later ones winning; checks every key.

    A file that sets `plugins` is refused: files of settings run no code.
    """
    from_file = _without_plugins(file, read_toml(file)) if file else {}
    assigned: dict[str, Any] = {}
    for assignment in assignments:
        assign(assigned, assignment)
    for name in (assigned.get("preset", ""), from_file.get("preset", "")):
        if not isinstance(name, str):
            raise ConfigError(f"preset is {name!r}; it is the name of a preset: {', '.join(plugins.presets())}")
    if preset and assigned.get("preset", preset) != preset:
        raise ConfigError(
            f"the preset is {preset!r}, and --set names the preset {assigned['preset']!r}; give one of them"
        )
    preset = preset or assigned.get("preset", "") or from_file.get("preset", "")
    preset = preset or _default_preset(plugins)
    base = _without_plugins(plugins.preset(preset), read_toml(plugins.preset(preset)))
    base.pop(DEFAULT_PRESET, None)
    given = {k: v for k, v in overrides.items() if v is not None}
    settings: dict[str, Any] = reduce(merge, (base, from_file, assigned, given), {})
    settings["preset"] = preset
    if "export" not in settings:
        raise ConfigError(f"the preset {preset!r} does not set export; set it to a list of formats, [] for none")
    try:
        config = build_options(RunConfig, settings, "settings")
        for name in config.plugins:
            plugins.register_named(name)
        _check_components(config, plugins)
    except ConfigError as error:
        if file is not None and _are_valid([base, assigned, given], plugins):
            raise ConfigError(f"{file}: {error}") from None
        raise
    return config


def _are_valid(layers: Sequence[Mapping[str, Any]], plugins: PluginManager) -> bool:
    """Whether merged settings pass the checks of `load_config`."""
    try:
        _check_components(build_options(RunConfig, reduce(merge, layers, {}), "settings"), plugins)
    except ConfigError:
        return False
    return True


def _without_plugins(file: Path, table: dict[str, Any]) -> dict[str, Any]:
    """The table of a settings file; one that names plugins is a `ConfigError`, because their code would be executed."""
    if table.get("plugins", []) != []:
        raise ConfigError(
            f"{file}: plugins are not loaded from a file of settings, because their code is executed; name them on the "
            "command line: --plugin FILE"
        )
    return table


def _default_preset(plugins: PluginManager) -> str:
    """The name of the preset that declares itself the default; `ConfigError` where none or several do."""
    found = []
    for name, path in plugins.presets().items():
        with suppress(ConfigError):  # a preset that is not used may be broken
            found += [name] if read_toml(path).get(DEFAULT_PRESET) is True else []
    if len(found) != 1:
        which = f"the presets {', '.join(found)} are all the default" if found else "no installed preset is the default"
        raise ConfigError(f"{which}; name one with --preset: {', '.join(plugins.presets()) or 'none is installed'}")
    return found[0]


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a table; `ConfigError` names the file and the line."""
    try:
        refuse_special_file(path)
        with path.open("rb") as stream:
            text = stream.read(MAX_SETTINGS_BYTES + 1).decode("utf-8")
        if len(text) > MAX_SETTINGS_BYTES or text.count(".") > MAX_SETTINGS_DOTS:
            raise ConfigError(
                f"{path} is no file of settings: it is larger than {MAX_SETTINGS_BYTES >> 10} kB, or has "
                f"more than {MAX_SETTINGS_DOTS} dots"
            )
        table = tomllib.loads(text)
    except InputError as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:  # also of an integer of more than 4300 digits
        raise ConfigError(f"{path}: not valid TOML: {error}") from None
    if _depth(table) > MAX_SETTINGS_DEPTH:
        raise ConfigError(f"{path}: its tables and lists are nested deeper than {MAX_SETTINGS_DEPTH} levels")
    return table


def _depth(value: Any) -> int:
    """Nesting levels of tables and lists; 0 for a number or a string."""
    levels, current = 0, [value]
    while current := [v for v in current if isinstance(v, dict | list)]:
        levels += 1
        current = [inner for v in current for inner in (v.values() if isinstance(v, dict) else v)]
    return levels


def assign(table: dict[str, Any], assignment: str) -> None:
    """Applies `a.b.c=value` to a nested table; the value is TOML, a bare word is a string.

    A part of the key that contains a dot is quoted, as in TOML: `exporter."simple.obj".digits=6`.
    """
    key, equals, text = assignment.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set {assignment!r}: write it as key=value, such as geometry.iterations=100")
    try:
        value = tomllib.loads(f"value = {text.strip()}")["value"]
    except (ValueError, RecursionError):
        value = text.strip()
    *parents, leaf = _parts_of_key(key, assignment)
    if len(parents) + _depth(value) > MAX_SETTINGS_DEPTH:
        raise ConfigError(f"--set {assignment[:40]!r}…: it is nested deeper than {MAX_SETTINGS_DEPTH} levels")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise ConfigError(
                f"--set {assignment!r}: {parent!r} was set to a value before, and is used as a table here"
            )
    table[leaf] = value


def _parts_of_key(key: str, assignment: str) -> list[str]:
    """The names in a dotted key of TOML."""
    if not {'"', "'"} & set(key):
        return [part.strip() for part in key.split(".")]
    try:
        table: Any = tomllib.loads(f"{key} = 0")
    except (ValueError, RecursionError):
        raise ConfigError(
            f"--set {assignment!r}: {key.strip()} is no key; quote the whole name that contains a dot, such as "
            'exporter."simple.obj".digits=6'
        ) from None
    parts = []
    while isinstance(table, dict) and len(table) == 1:
        name, table = next(iter(table.items()))
        parts.append(name)
    return parts


def merge(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Tables merge key by key; anything else is replaced."""
    merged = dict(base)
    for key, value in change.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged


def _check_components(config: RunConfig, plugins: PluginManager) -> None:
    """Checks the names and options of all components before anything runs."""
    tables = ("initializer", "mask_source", "geometry_renderer", "reflectance_renderer", "exporter")
    for kind in tables:
        for name, options in getattr(config, kind).items():
            build_options(plugins.find(kind, name).component.config, options, f"{kind} {name!r}")
    observers = plugins.observers()
    for name, options in config.observers.items():
        if name not in observers:
            raise ConfigError(f"there is no observer {name!r}; installed: {', '.join(observers) or 'none'}")
        if options is not False:
            build_options(observers[name], options, f"observer {name!r}")
    _check_regularizers(config, plugins)
    _check_renderers(config, plugins)
    chains = (("initializer", config.initializers), ("mask_source", config.masks), ("exporter", config.export))
    for kind, names in chains:
        for name in () if names == "auto" else names:
            plugins.find(kind, name)


def _check_regularizers(config: RunConfig, plugins: PluginManager) -> None:
    """The terms of both stages exist, have valid options, and do not depend on what their stage does not have."""
    for stage, tables in (("geometry", config.geometry.regularizers), ("reflectance", config.reflectance.regularizers)):
        for name, options in tables.items():
            term = plugins.find("regularizer", name).component
            if options is False:
                continue
            owner, own = f"{stage}.regularizers.{name}", dict(options)
            weight = {key: own.pop(key) for key in ("weight",) if key in own}
            build_options(TermWeight, weight, owner)
            build_options(term.config, own, owner, beside=("weight",))
            needs = sorted({"material", "environment"} & term.traits)
            if stage == "geometry" and needs:
                raise ConfigError(
                    f"geometry.regularizers.{name}: the term depends on {' and '.join(needs)}, which the geometry "
                    f"stage does not fit; move it to reflectance.regularizers.{name}"
                )


def _check_renderers(config: RunConfig, plugins: PluginManager) -> None:
    """The renderers that a run needs are set and exist."""
    reflectance, tracing = config.reflectance, config.reflectance.path_tracing
    traced = reflectance.enabled and reflectance.method != "gradient"
    traced = traced and bool(tracing.refine_albedo or tracing.iterations)
    for kind, setting, name, needed in (
        ("geometry_renderer", "geometry.renderer", config.geometry.renderer, config.geometry.enabled),
        ("reflectance_renderer", "reflectance.renderer", reflectance.renderer, reflectance.enabled),
        ("reflectance_renderer", "reflectance.path_tracing.renderer", tracing.renderer, traced),
    ):
        if name:
            plugins.find(kind, name)
        elif needed:
            names = ", ".join(registered.component.name for registered in plugins.components(kind))
            raise ConfigError(f"the preset {config.preset!r} does not set {setting}; set it to one of: {names}")
