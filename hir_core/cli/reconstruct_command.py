"""`hir reconstruct`: photographs in, asset out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import click

from hir_core.config import ModelName
from hir_core.plugins.options import MAX_SEED
from hir_core.run.run_directory import STAGE_NAMES
from hir_core.terminal.command_options import FOLDER, plugin_option, settings_options, verbosity_options
from hir_core.terminal.plugin_problems import echo_problems
from hir_core.terminal.required_packages import require_reconstruction_packages
from hir_core.terminal.run_results import show_summary


@click.command("reconstruct")
@click.argument("capture", type=FOLDER)
@click.option("-o", "--output", "run", type=FOLDER, required=True, metavar="RUN", help="Folder of the run.")
@settings_options
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), help="auto uses CUDA if there is a device.")
@click.option(
    "--resume", is_flag=True, help="Continue a run: reuse finished stages whose settings and input are unchanged."
)
@click.option("--until", type=click.Choice(STAGE_NAMES), help="Stop after this stage.")
@click.option(
    "--model", type=click.Choice(get_args(ModelName)), help="Reflectance model; auto selects it on held-out views."
)
@click.option("--triangles", type=click.IntRange(min=0), help="Number of triangles; 0 derives it from the views.")
@click.option(
    "--texture-size", type=click.IntRange(min=0), help="Side of the textures in texels; 0 derives it from the views."
)
@click.option("--seed", type=click.IntRange(0, MAX_SEED), help="Seed of all random numbers.")
@click.option("--max-memory", metavar="SIZE", help="Memory limit, such as 4GB: caches and batches are reduced to fit.")
@click.option("--deterministic", is_flag=True, help="Bit-identical files for equal input on one machine; slower.")
@plugin_option
@verbosity_options
def reconstruct_command(
    capture: Path,
    run: Path,
    preset: str,
    config_file: Path | None,
    assignments: tuple[str, ...],
    device: str | None,
    resume: bool,
    until: str | None,
    model: str | None,
    triangles: int | None,
    texture_size: int | None,
    seed: int | None,
    max_memory: str | None,
    deterministic: bool,
    plugin_files: tuple[str, ...],
    quiet: bool,
    verbose: bool,
) -> None:
    """Reconstructs mesh, PBR textures and light from the photographs of CAPTURE, in the folder RUN."""
    from hir_core.plugins.manager import PluginManager
    from hir_core.terminal.progress_bar import ProgressBar

    chosen = list(assignments)
    if model is not None:
        chosen.append(f"reflectance.model={model}")
    if triangles is not None:
        chosen.append(f"geometry.triangles={triangles}")
    if texture_size is not None:
        chosen.append(f"atlas.texture_size={texture_size}")
    if plugin_files:
        chosen.append(f"plugins={json.dumps(plugin_files)}")
    overrides: dict[str, Any] = {"seed": seed, "max_memory": max_memory, "deterministic": deterministic or None}
    require_reconstruction_packages("hir reconstruct")
    plugins = PluginManager.discover(plugin_files)
    echo_problems(plugins.problems)
    for notice in plugins.notices:
        click.echo(f"hir: plugin notice: {notice}", err=True)
    from hir_core.pipeline import reconstruct

    with ProgressBar(quiet=quiet) as bar:
        result = reconstruct(
            capture,
            run,
            preset=preset,
            config=config_file,
            assignments=chosen,
            device=device,
            resume=resume,
            until=until,
            plugins=plugins,
            on_progress=bar.update,
            on_message=bar.message,
            **overrides,
        )
    if not quiet:
        show_summary(result.directory)
