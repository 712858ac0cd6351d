"""`hir light-probe`."""

from __future__ import annotations

from pathlib import Path

import click
from click.core import ParameterSource

from hir_core.errors import ConfigError, InputError
from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages


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
    help="Photographs of the object. The light gets their brightness by the exposures that both record, and the axes "
    "of the light that the object's capture names, if it names one.",
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
    from hir_exporters.textures.image_files import write_exr, write_hdr

    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.light_files import world_from_light
    from hir_core.run.python_warnings import forward_user_warnings
    from hir_plugins.commands.light_probe.ball_photographs import exposed_views, read_ball
    from hir_plugins.commands.light_probe.grey_ball import with_lamps_of_grey_ball
    from hir_plugins.commands.light_probe.mirror_ball import mirror_ball_light

    source = click.get_current_context().get_parameter_source("grey_reflectance")
    if grey_ball is None and source is ParameterSource.COMMANDLINE:
        raise ConfigError("--grey-reflectance has no effect without --grey-ball; leave it out, or add --grey-ball")
    suffix = output.suffix.lower()
    if suffix not in (".hdr", ".exr"):
        raise InputError(f"{output} must end in .hdr or .exr; give another name with -o")
    if not output.parent.is_dir():
        raise InputError(f"the folder {output.parent} does not exist; create it or give another name with -o")
    plugins = PluginManager.discover(plugin_files)
    agreement = ""
    with forward_user_warnings(lambda sentence: click.echo(f"hir: {sentence}", err=True)):
        reference = None if object_photos is None else read_capture(object_photos, "train", plugins)
        mirror = read_ball(photos, plugins)
        stated = (reference or mirror.capture).environment  # only captures of research state axes of a light's file
        views = exposed_views(mirror.capture, reference)
        axes = world_from_light(mirror.capture.world_from_source, stated)
        probe = mirror_ball_light(views, mirror.ball, axes, rows, reflectance)
        if grey_ball is not None:
            grey = read_ball(grey_ball, plugins)
            # a reader may turn the world of each folder by itself
            axes = world_from_light(grey.capture.world_from_source, stated)
            exposed = exposed_views(grey.capture, reference or mirror.capture)
            try:
                probe, deviation = with_lamps_of_grey_ball(probe, exposed, grey.ball, axes, grey_reflectance)
            except InputError as error:
                raise InputError(f"{grey_ball}: {error}") from None
            agreement = f"; its irradiance and that of the grey ball differ by {deviation:.1%} (median)"
    (write_hdr if suffix == ".hdr" else write_exr)(output, probe.radiance)
    if quiet:
        return
    mean, largest = float(probe.radiance.mean()), float(probe.radiance.max())
    click.echo(f"{output}  {rows}×{2 * rows}, mean radiance {mean:.3g}, largest {largest:.3g}{agreement}")
    click.echo(
        f"{len(views)} photographs; outlines of the ball deviate by {mirror.ball.deviation_pixels:.2f} pixels; "
        f"{probe.unseen:.1%} of the directions were not seen and are filled from beside them"
    )
    if probe.clipped > 0 and grey_ball is None:
        click.echo(
            f"hir: {100 * probe.clipped:.2g} % of the directions are clipped in all photographs, so lamps are too dark "
            "there: add shorter exposures (their EXIF data are read), or photographs of a grey ball (--grey-ball)",
            err=True,
        )
