"""The group of commands, found on first use, and the one place where errors become sentences."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import click
from hir_exporters.errors import HirError

from hir_core import __version__
from hir_core.run.interrupt import remember_interrupts

COMMANDS = {
    "check": "hir_core.cli.check:check_command",
    "reconstruct": "hir_core.cli.reconstruct:reconstruct_command",
    "export": "hir_core.cli.export:export_command",
    "evaluate": "hir_core.cli.evaluate:evaluate_command",
    "render": "hir_core.cli.render:render_command",
    "report": "hir_core.cli.report:report_command",
    "edit": "hir_core.cli.edit:edit_command",
    "cameras": "hir_core.cli.cameras:cameras_command",
    "plugins": "hir_core.cli.plugins:plugins_command",
    "new-plugin": "hir_core.cli.new_plugin:new_plugin_command",
    "check-plugin": "hir_core.cli.check_plugin:check_plugin_command",
    "doctor": "hir_core.cli.doctor:doctor_command",
    "config": "hir_core.cli.config:config_group",
}

INPUT_ERROR = 2
INTERRUPTED = 130
INTERRUPTION = "hir: interrupted; a run continues where it was with --resume"


class LazyGroup(click.Group):
    """Imports a command's module when the command is named, and asks plugins for theirs when none of ours fits."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        self._add_plugin_commands()
        return [*COMMANDS, *sorted(name for name in self.commands if name not in COMMANDS)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in COMMANDS:
            module, _, attribute = COMMANDS[cmd_name].partition(":")
            command: click.Command = getattr(import_module(module), attribute)
            return command
        self._add_plugin_commands()
        return self.commands.get(cmd_name)

    def _add_plugin_commands(self) -> None:
        from hir_core.plugins.manager import PluginManager

        if not ctx_object().get("plugins_asked"):
            ctx_object()["plugins_asked"] = True
            PluginManager.discover().notify("hir_register_commands", cli=self)


def ctx_object() -> dict[str, Any]:
    """What the commands of one call share."""
    context = click.get_current_context(silent=True)
    root = context.find_root() if context is not None else None
    if root is None:
        return {}
    if root.obj is None:
        root.obj = {}
    shared: dict[str, Any] = root.obj
    return shared


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="hir")
def cli() -> None:
    """Photographs in, a game-ready asset out."""


def main(arguments: Sequence[str] | None = None) -> None:
    """The entry point `hir`: exit code 0, 2 for what the user can mend, 130 when interrupted, 1 for a bug."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    verbose = "-v" in words or "--verbose" in words
    if arguments is None and not verbose:
        warnings.simplefilter("ignore")  # libraries advising their programmers
    if arguments is None:
        remember_interrupts(_leave)
    try:
        code = cli.main(words, prog_name="hir", standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.exceptions.NoArgsIsHelpError as shown:
        click.echo(shown.format_message())
        code = INPUT_ERROR
    except click.ClickException as error:
        error.show()
        code = INPUT_ERROR
    except HirError as error:
        if verbose:
            traceback.print_exc()
        click.echo(f"hir: {error}", err=True)
        code = INPUT_ERROR
    except (KeyboardInterrupt, click.Abort):
        code = INTERRUPTED
        if arguments is None:  # a process of our own: tearing down compilers and thread pools takes seconds
            _leave()
        click.echo(INTERRUPTION, err=True)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has left; Python would complain while it shuts down
        code = 1
    except Exception as error:
        if verbose:
            traceback.print_exc()
        click.echo(
            f"hir: this is a bug: {type(error).__name__}: {error} (run again with -v for where it happened)", err=True
        )
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


def _leave() -> None:
    """Ends the process at once after Ctrl-C."""
    click.echo(INTERRUPTION, err=True)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(INTERRUPTED)
