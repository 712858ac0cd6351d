"""`hir doctor`: checks the installation."""

from __future__ import annotations

import json
from dataclasses import asdict

import click


@click.command("doctor")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor_command(as_json: bool) -> None:
    """Checks what is installed and whether it works, and advises what to install. Exit code 1 if anything fails."""
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
