"""`hir card`."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.terminal.command_options import FOLDER, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages


@click.command("card")
@click.option("-o", "--output", type=FOLDER, required=True, metavar="FILE", help="File to write, .pdf or .png.")
@click.option("--paper", type=click.Choice(["a4", "letter"]), default="a4", help="Size of the paper; a4 by default.")
@verbosity_options
def card_command(output: Path, paper: str, quiet: bool, verbose: bool) -> None:
    """Writes a card to print, which gives photographs metres, white balance and brightness.

    Print it without scaling on matt paper, measure the side of a black square, and lay the card flat beside the object,
    so that most photographs show it. Then:

    hir reconstruct PHOTOS -o RUN --set initializer.fiducial_markers.side=0.05
    """
    require_reconstruction_packages("hir card")
    from hir_plugins.commands.card.card_page import side_of_markers, write_card

    write_card(output, paper)
    if not quiet:
        side = side_of_markers(paper)
        click.echo(f"{output}  {output.stat().st_size / 1e6:.2f} MB")
        click.echo(
            f"Printed without scaling, a black square has sides of {1000 * side:g} mm. Measure one, lay the card flat "
            f"beside the object, and reconstruct with: --set initializer.fiducial_markers.side={side:g}"
        )
