"""`hir doctor`."""

from __future__ import annotations

import json
from dataclasses import asdict

import click


@click.command("doctor")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def doctor_command(as_json: bool) -> None:
    """Says what is installed and works, and what to install where something does not; exit code 1 if anything fails."""
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.installation_check import examine

    findings = examine(PluginManager.discover().problems)
    if as_json:
        click.echo(json.dumps([asdict(finding) for finding in findings], indent=1))
    else:
        for finding in findings:
            click.echo(f"{finding.state:>8}  {finding.name:<22}  {finding.detail}")
            if finding.advice:
                click.echo(f"{'':>8}  {'':<22}  → {finding.advice}")
    if any(finding.state in ("missing", "broken") for finding in findings):
        raise click.exceptions.Exit(1)
