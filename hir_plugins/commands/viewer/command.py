"""`hir view`."""

from __future__ import annotations

import contextlib
from pathlib import Path

import click

from hir_core.cli.options import FOLDER, loudness_options


@click.command("view")
@click.argument("source", type=FOLDER, metavar="RUN|FILE")
@click.option("--save", type=FOLDER, metavar="PAGE.html", help="Write one page that needs nothing beside it, and stop.")
@click.option("--light", type=FOLDER, metavar="FILE", help="A lat-long .hdr or .exr instead of the asset's own light.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the local page; 0 takes a free one.")
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser; on by default.")
@loudness_options
def view_command(
    source: Path, save: Path | None, light: Path | None, port: int, browser: bool, quiet: bool, verbose: bool
) -> None:
    """Shows a run, a scene folder or an exported file in a browser: turn it, turn its light, look at each channel.

    The page is served to this machine alone and asks nothing of the network. Ctrl-C ends it.
    """
    from hir_plugins.commands.viewer.viewer_page import serve, view_page

    page = view_page(source, light)
    if save is not None:
        from hir_exporters.files.atomic import write_text_atomic

        write_text_atomic(save, page)
        if not quiet:
            click.echo(f"{save}  {save.stat().st_size / 1e6:.2f} MB")
        return

    def ready(address: str) -> None:
        click.echo(f"{address}  (Ctrl-C ends it)")
        if browser:
            import webbrowser

            webbrowser.open(address)

    with contextlib.suppress(KeyboardInterrupt):
        serve(page, port, ready)
