"""`hir light-probe`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hir_core.errors import InputError
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages

if TYPE_CHECKING:
    from hir_core.capture import Array, Capture, View
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.light_probe.sphere_fit import Sphere

NOTABLE_SHARE = 1e-4
"""Of the directions: a sun has 1e-5, its glare more."""


@click.command("light-probe")
@click.argument("photos", type=FOLDER)
@click.option(
    "-o", "--output", type=FOLDER, required=True, metavar="FILE", help="Lat-long file to write, .hdr or .exr."
)
@click.option(
    "--object",
    "object_photos",
    type=FOLDER,
    metavar="PHOTOS",
    help="Photographs of the object. The light gets their brightness by the exposures that both record.",
)
@click.option(
    "--reflectance",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.6,
    show_default=True,
    help="Share of the light that the ball reflects: chromed steel about 0.6, silvered glass 0.9.",
)
@click.option(
    "--grey-ball",
    type=FOLDER,
    metavar="PHOTOS",
    help="Photographs of a matt grey ball in the same place: it shows how bright lamps are that the mirror clips.",
)
@click.option(
    "--grey-reflectance",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.18,
    show_default=True,
    help="Reflectance of the grey ball.",
)
@click.option("--rows", type=click.IntRange(8, 1024), default=128, show_default=True, help="Height of the image.")
@plugin_option
@verbosity_options
def light_probe_command(
    photos: Path,
    output: Path,
    object_photos: Path | None,
    reflectance: float,
    grey_ball: Path | None,
    grey_reflectance: float,
    rows: int,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Measures the light of a place with photographs of a mirror ball.

    Put the ball where the object stood, and photograph it with the object's cameras (one project of the scanning
    program) from two or more sides, in short and long exposures so that no lamp is clipped in all of them. The sun is
    too bright for that: photograph a matt grey ball in the same place, too (--grey-ball). The photographs need cameras
    and masks of the ball. Then:

    hir reconstruct OBJECT -o RUN --set 'reflectance.known_environment="light.hdr"'
    """
    require_reconstruction_packages("hir light-probe")
    import numpy as np
    from hir_exporters.textures.image_files import write_exr, write_hdr

    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.light_probe.grey_ball import with_lamps_of_grey_ball
    from hir_plugins.commands.light_probe.mirror_ball import mirror_ball_light

    suffix = output.suffix.lower()
    if suffix not in (".hdr", ".exr"):
        raise InputError(f"{output} must end in .hdr or .exr; give another name with -o")
    if not output.parent.is_dir():
        raise InputError(f"the folder {output.parent} does not exist; create it or give another name with -o")
    plugins = PluginManager.discover(plugin_files)
    reference = None if object_photos is None else read_capture(object_photos, "train", plugins)
    capture = masked_ball(photos, plugins)
    views, ball = exposed_views(capture, reference), sphere_of(capture)
    stated = (reference or capture).environment  # only captures of research state axes of their light's file
    axes = stated.source_from_environment if stated is not None else np.eye(3)
    probe = mirror_ball_light(views, ball, rotation_of(capture) @ axes, rows, reflectance)
    agreement = ""
    if grey_ball is not None:
        matt = masked_ball(grey_ball, plugins)
        # a reader may turn the world of each folder by itself
        turned = rotation_of(matt) @ axes
        try:
            probe, deviation = with_lamps_of_grey_ball(
                probe, exposed_views(matt, reference or capture), sphere_of(matt), turned, grey_reflectance
            )
        except InputError as error:
            raise InputError(f"{grey_ball}: {error}") from None
        agreement = f"; its irradiance and that of the grey ball differ by {deviation:.1%} (median)"
    (write_hdr if suffix == ".hdr" else write_exr)(output, probe.radiance)
    if quiet:
        return
    mean, largest = float(probe.radiance.mean()), float(probe.radiance.max())
    click.echo(f"{output}  {rows}×{2 * rows}, mean radiance {mean:.3g}, largest {largest:.3g}{agreement}")
    click.echo(
        f"{len(views)} photographs; outlines of the ball deviate by {ball.deviation_pixels:.2f} pixels; "
        f"{probe.unseen:.1%} of the directions were not seen and are filled from beside them"
    )
    if probe.clipped > NOTABLE_SHARE and grey_ball is None:
        click.echo(
            f"hir: {probe.clipped:.2%} of the directions are clipped in all photographs, so lamps are too dark there: "
            "add shorter exposures (their EXIF data are read), or photographs of a grey ball (--grey-ball)",
            err=True,
        )


def sphere_of(capture: Capture) -> Sphere:
    """The ball; `InputError` with the folder where the masks show none."""
    from hir_plugins.commands.light_probe.sphere_fit import fit_sphere

    outlines = []
    for view in capture.views:
        mask = view.pixels().mask
        assert view.camera is not None and mask is not None
        outlines.append((view.camera, mask))
    try:
        return fit_sphere(outlines)
    except InputError as error:
        raise InputError(f"{capture.path}: {error}") from None


def rotation_of(capture: Capture) -> Array:
    """3×3, from the axes of the capture's files to the world of its views."""
    import numpy as np

    linear = capture.world_from_source[:3, :3]
    return linear / np.cbrt(np.linalg.det(linear))


def masked_ball(photos: Path, plugins: PluginManager) -> Capture:
    """The photographs with cameras and masks; `InputError` where either is missing."""
    from hir_core.intake.mask_sources import apply_mask_sources
    from hir_core.intake.reader_lookup import read_capture

    capture = read_capture(photos, "train", plugins)
    if not capture.views or any(view.camera is None for view in capture.views):
        raise InputError(
            f"{photos} has photographs without cameras; export the scanning program's cameras of these photographs, "
            "too (docs/captures.md)"
        )
    for known in ("photographs", "cameras"):
        capture = apply_mask_sources(capture, None, "auto", {}, plugins, known=known)  # type: ignore[arg-type]
    if any(view.pixels().mask is None for view in capture.views):
        raise InputError(f"{photos} has photographs without a mask of the ball; add masks (docs/captures.md#masks)")
    return capture


def exposed_views(capture: Capture, reference: Capture | None) -> list[View]:
    """The views with their recorded exposures beside those of the object's photographs, or beside their own mean."""
    own = _recorded(capture)
    others = None if reference is None else _recorded(reference)
    if own is None or (reference is not None and others is None):
        if reference is not None:
            without = capture.path if own is None else reference.path
            click.echo(
                f"hir: {without} records no exposures, so the ball and the object count as equally exposed: keep the "
                "EXIF data, or scale the light with FILE*STRENGTH",
                err=True,
            )
        if own is None:
            return list(capture.views)
    middle = _geometric_mean(own if others is None else others)
    return [replace(v, exposure=v.exposure * each / middle) for v, each in zip(capture.views, own, strict=True)]


def _recorded(capture: Capture) -> list[float] | None:
    """The exposure of each view; None where none is recorded, `InputError` where some are."""
    from hir_core.capture.photograph_exposures import recorded_exposure

    found = [recorded_exposure(view) for view in capture.views]
    known = [each for each in found if each is not None]
    if known and len(known) < len(found):
        name = next(view.name for view, each in zip(capture.views, found, strict=True) if each is None)
        raise InputError(
            f"{capture.path}: {name} records no exposure, others do; give photographs that all have EXIF data"
        )
    return known or None


def _geometric_mean(values: list[float]) -> float:
    return math.exp(sum(map(math.log, values)) / len(values))
