"""Runs external validators on files: Khronos' glTF validator (node), pxr.UsdValidation, omniverse-asset-validator."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hir_exporters.errors import ExportError


@dataclass(frozen=True)
class Finding:
    """One message of a validator about a file."""

    file: Path
    severity: Literal["error", "warning", "information"]
    code: str
    message: str


def validate_gltf(files: Sequence[Path], tools: Path) -> list[Finding]:
    """Findings of Khronos' validator for .glb and .gltf files.

    `tools` is the repository's folder of that name, after `tools/setup.sh test`. Raises `ExportError` where node or the
    validator is missing.
    """
    node = shutil.which("node")
    if node is None or not (tools / "node_modules" / "gltf-validator").is_dir():
        raise ExportError(f"the glTF validator is not installed; install node and run {tools / 'setup.sh'} test")
    command = [node, str(tools / "validate_gltf.cjs"), *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode != 0:
        raise ExportError(f"the glTF validator failed on {', '.join(map(str, files))}: {done.stderr.strip()}")
    severities: tuple[Literal["error", "warning", "information"], ...] = (
        "error",
        "warning",
        "information",
        "information",
    )
    findings = []
    for file, line in zip(files, done.stdout.splitlines(), strict=True):
        for message in json.loads(line)["issues"]["messages"]:
            where = message.get("pointer", "")
            text = f"{message['message']} {where}".strip()
            findings.append(Finding(Path(file), severities[message["severity"]], message["code"], text))
    return findings


def validate_usd(files: Sequence[Path]) -> list[Finding]:
    """Findings of all validators of pxr.UsdValidation for USD files."""
    from pxr import Usd, UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    kinds = UsdValidation.ValidationErrorType
    findings = []
    for file in files:
        stage = Usd.Stage.Open(str(file))
        if stage is None:
            raise ExportError(f"{file} cannot be opened as USD")
        for error in context.Validate(stage):
            severity: Literal["error", "warning", "information"] = "information"
            if error.GetType() == kinds.Error:
                severity = "error"
            elif error.GetType() == kinds.Warn:
                severity = "warning"
            findings.append(Finding(Path(file), severity, str(error.GetName()), str(error.GetMessage())))
    return findings


def validate_omniverse(files: Sequence[Path]) -> list[Finding]:
    """Findings of omniverse-asset-validator for USD files, without the rules that advise against text files.

    Raises `ExportError` where it is not installed; it does not support Python 3.13 and newer.
    """
    try:
        import omni.asset_validator as omniverse
    except ImportError:
        raise ExportError("NVIDIA's validator is missing: pip install omniverse-asset-validator") from None
    kinds = omniverse.IssueSeverity
    severities: dict[object, Literal["error", "warning", "information"]] = {
        kinds.ERROR: "error",
        kinds.FAILURE: "error",
        kinds.WARNING: "warning",
        kinds.INFO: "information",
    }
    findings = []
    for file in files:
        for issue in omniverse.ValidationEngine(init_rules=True).validate(str(file)).issues():
            rule = issue.rule.__name__ if issue.rule else "?"
            if issue.severity != kinds.NONE and "Ascii" not in rule:  # .usda is text by definition
                findings.append(Finding(Path(file), severities[issue.severity], rule, str(issue.message)))
    return findings
