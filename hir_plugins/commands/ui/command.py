"""`hir ui`."""

from __future__ import annotations

import contextlib
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hir_core.terminal.command_options import FOLDER, verbosity_options
from hir_core.terminal.required_packages import require_reconstruction_packages

if TYPE_CHECKING:
    from hir_plugins.commands.ui.ui_server import PresetChoice


@click.command("ui")
@click.argument("folder", type=FOLDER, default="hir-captures")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the local server; 0 picks a free one.")
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser; on by default.")
@verbosity_options
def ui_command(folder: Path, port: int, browser: bool, quiet: bool, verbose: bool) -> None:
    """Opens a page on which captures are dropped, checked and reconstructed.

    Copies of dropped photographs, checks and runs are written to FOLDER (hir-captures by default) and to no other
    place. The page runs `hir check`, `hir reconstruct` and `hir delight`; it is served on the loopback interface only.
    Press Ctrl-C to stop the server and what it runs: runs can be resumed.
    """
    require_reconstruction_packages("hir ui")
    from hir_plugins.commands.loopback_server import bound_server
    from hir_plugins.commands.ui.capture_library import CaptureLibrary
    from hir_plugins.commands.ui.ui_server import UiServer

    signal.signal(signal.SIGTERM, _interrupt)
    with contextlib.closing(CaptureLibrary(folder)) as library:
        choices = preset_choices()
        with contextlib.suppress(KeyboardInterrupt), bound_server(lambda p: UiServer(library, choices, p), port) as ui:
            click.echo(ui.address if quiet else f"{ui.address}  (press Ctrl-C to stop)")
            if browser:
                import webbrowser

                webbrowser.open(ui.entrance)
            ui.serve_forever()


def preset_choices() -> list[PresetChoice]:
    """The presets, each with the comment at the top of its file; the default one first, the one for scans last."""
    from hir_core.config import DEFAULT_PRESET, read_toml
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.delight.command import PRESET as NEEDS_A_SCAN
    from hir_plugins.commands.ui.ui_server import PresetChoice

    choices = [
        PresetChoice(
            name, leading_comment(path), bool(read_toml(path).get(DEFAULT_PRESET, False)), name == NEEDS_A_SCAN
        )
        for name, path in PluginManager.discover().presets().items()
    ]
    return sorted(choices, key=lambda choice: (choice.needs_scan, not choice.default))


def leading_comment(path: Path) -> str:
    """The comment with which a TOML file begins, on one line, without the marks of code."""
    words = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        words.append(line.lstrip("#").strip())
    return " ".join(words).replace("`", "")


def _interrupt(number: int, frame: object) -> None:
    """SIGTERM ends the server as Ctrl-C does, so that nothing goes on computing without it."""
    raise KeyboardInterrupt
