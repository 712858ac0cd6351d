"""The command group `hir`, which imports a command when it is used, and the conversion of errors to messages."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import click
from hir_exporters.errors import HirError, InputError

from hir_core import __version__
from hir_core.errors import MissingExtraError
from hir_core.files.file_names import on_one_line
from hir_core.plugins.engine_commands import ENGINE_COMMANDS
from hir_core.run.interrupt import remember_interrupts, was_interrupted

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

INPUT_ERROR = 2
INTERRUPTED = 130
RESUMABLE = "reconstruct"
"""The engine's command that has `--resume`; its module may not be imported yet when it is interrupted."""


class LazyGroup(click.Group):
    """Imports the module of a command when the command is used; asks plugins for commands that are not built in."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        self._add_plugin_commands()
        return [*ENGINE_COMMANDS, *sorted(name for name in self.commands if name not in ENGINE_COMMANDS)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in ENGINE_COMMANDS:
            module, _, attribute = ENGINE_COMMANDS[cmd_name].partition(":")
            command: click.Command = getattr(import_module(module), attribute)
            return command
        self._add_plugin_commands()
        return self.commands.get(cmd_name)

    def _add_plugin_commands(self) -> None:
        from hir_core.plugins.manager import PluginManager

        if not shared_state().get("plugin_commands_added"):
            shared_state()["plugin_commands_added"] = True
            plugins = shared_state().get("plugins") or PluginManager.discover()
            for name, command in plugins.commands().items():
                self.add_command(command, name)


def shared_state() -> dict[str, Any]:
    """A dictionary that all commands of one call share."""
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
    """Reconstructs game-ready assets from photographs: mesh, PBR textures and light."""


def main(arguments: Sequence[str] | None = None, plugins: PluginManager | None = None) -> None:
    """The entry point `hir`. Exit codes: 0, 2 for an error the user can correct, 130 when interrupted, 1 for a bug.

    `plugins` are those whose commands are added; the installed ones by default.
    """
    command_line = list(sys.argv[1:] if arguments is None else arguments)
    verbose = "-v" in command_line or "--verbose" in command_line
    if arguments is None and not verbose:
        warnings.simplefilter("ignore")  # they address programmers, not users
    if arguments is None:
        remember_interrupts(partial(_exit_at_once, command_line))
    try:
        code = cli.main(command_line, prog_name="hir", standalone_mode=False, obj={"plugins": plugins})
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.exceptions.NoArgsIsHelpError as shown:
        click.echo(shown.format_message())
        code = INPUT_ERROR
    except click.ClickException as error:
        error.show()
        code = INPUT_ERROR
    except BrokenPipeError:
        sys.stderr.close()  # the reader of the output is closed; otherwise Python prints an error at exit
        code = 1
    except (KeyboardInterrupt, Exception) as raised:
        failure = _of_user(raised)
        # an import of native code that is interrupted raises an ImportError
        interrupted = isinstance(failure, (KeyboardInterrupt, click.Abort)) or (arguments is None and was_interrupted())
        code = INTERRUPTED if interrupted else INPUT_ERROR if isinstance(failure, HirError) else 1
        if verbose and not interrupted:
            traceback.print_exc()
        if interrupted and arguments is None:
            _exit_at_once(command_line)  # an orderly shutdown of compilers and thread pools takes seconds
        click.echo(_sentence(failure, code, command_line), err=True)
    sys.exit(code if isinstance(code, int) else 0)


def _of_user(error: BaseException) -> BaseException:
    """A `HirError` in place of the system's error of a path that is too long, of a full disk, or of a missing library.

    Every argument and option can be such a path, and each way to ask for a file fails on it. Containers lack libraries
    of the system that wheels need: open3d needs libEGL. Other errors stay as they are.
    """
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return InputError(
            f"the path {str(error.filename)[:200]!r}… is longer than the system allows; give a shorter one"
        )
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        place = f"for {error.filename}" if error.filename else "for the output"
        return InputError(f"there is no space left {place} ({error.strerror}); free some, or write to another disk")
    if isinstance(error, ImportError) and "cannot open shared object file" in str(error):
        from hir_core.run.installation_check import library_advice

        library, advice = str(error).partition(":")[0], library_advice(str(error)) or "install its package"
        return MissingExtraError(
            f"a Python package needs the library {library}, which this system lacks; {advice} "
            "(`hir doctor` tests every package)"
        )
    return error


def _sentence(error: BaseException, code: int, command_line: Sequence[str]) -> str:
    """What the user reads."""
    if code == INTERRUPTED:
        return _interruption(command_line)
    if isinstance(error, HirError):
        return f"hir: {on_one_line(str(error))}"
    from hir_core.plugins.failure_origin import origin_of

    reason = on_one_line(f"{type(error).__name__}: {error}")
    if origin := origin_of(error):
        return f"hir: {origin} raised {reason}; report it to its author (-v prints the traceback)"
    return f"hir: this is a bug: {reason} (-v prints the traceback)"


def _interruption(command_line: Sequence[str]) -> str:
    """The sentence after Ctrl-C."""
    return "hir: interrupted" + ("; continue the run with --resume" if _is_resumable(command_line[:1]) else "")


def _is_resumable(name: Sequence[str]) -> bool:
    """Whether the command has `--resume`; nothing is imported, because the process is about to end."""
    command = cli.commands.get(name[0]) if name else None
    return RESUMABLE in name or (command is not None and any("--resume" in p.opts for p in command.params))


def _exit_at_once(command_line: Sequence[str]) -> None:
    """Ends the process at once after Ctrl-C."""
    click.echo(_interruption(command_line), err=True)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(INTERRUPTED)
