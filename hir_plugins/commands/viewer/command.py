"""`hir view`."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hir_core.errors import ConfigError, InputError
from hir_core.terminal.command_options import FOLDER, verbosity_options

if TYPE_CHECKING:
    from hir_plugins.commands.viewer.page_server import PageServer


@click.command("view")
@click.argument("source", type=FOLDER, metavar="RUN|FILE")
@click.option(
    "--save", type=FOLDER, metavar="PAGE.html", help="Write the page to one self-contained file instead of serving it."
)
@click.option(
    "--light", type=FOLDER, metavar="FILE", help="Light the asset with this lat-long .hdr or .exr file instead."
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the local server; 0 picks a free one.")
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser; on by default.")
@verbosity_options
def view_command(
    source: Path, save: Path | None, light: Path | None, port: int, browser: bool, quiet: bool, verbose: bool
) -> None:
    """Shows a run, a scene folder or an exported file in a browser.

    The page rotates the asset and its light and shows each material channel. It is served on the loopback interface
    only and loads nothing from the network. Press Ctrl-C to stop the server.
    """
    from hir_core.run.python_warnings import forward_user_warnings
    from hir_core.terminal.run_results import say_earlier_scene
    from hir_plugins.commands.viewer.page_server import serve
    from hir_plugins.commands.viewer.viewer_page import view_page

    if save is not None and save.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"--save {save}: the page is HTML; give a name that ends in .html")
    with contextlib.suppress(InputError):  # a damaged run.json does not keep a scene from being shown
        say_earlier_scene(source, "the page shows")
    with forward_user_warnings(lambda text: click.echo(f"hir: {text}", err=True)):
        page = view_page(source, light)
    if save is not None:
        from hir_exporters.files.atomic import write_text_atomic

        write_text_atomic(save, page)
        if not quiet:
            click.echo(f"{save}  {save.stat().st_size / 1e6:.2f} MB")
        return

    def ready(server: PageServer) -> None:
        click.echo(f"{server.address}  (press Ctrl-C to stop)")
        if browser:
            import webbrowser

            webbrowser.open(server.entrance)

    with contextlib.suppress(KeyboardInterrupt):
        serve(page, port, ready)
