"""Which files of a run's folder Blender opens. Nothing here needs Blender."""

import json
from pathlib import Path

from .hir_process import HirError

LIGHTS = (".exr", ".hdr")
"""By preference: .exr has no loss."""


def check_run(run):
    """Raises `HirError` unless `run` is the folder of a finished run."""
    try:
        document = json.loads((run / "run.json").read_text(encoding="utf-8"))
    except OSError:
        raise HirError(f"{run} is not the folder of a run: it has no run.json") from None
    except ValueError:
        raise HirError(f"{run / 'run.json'} is damaged: run hir again with --resume") from None
    if not isinstance(document, dict) or document.get("format") != "hir-run":
        raise HirError(f"{run} is not the folder of a run: its run.json is of another program")
    if not (run / "scene").is_dir():
        raise HirError(f"the run of {run} is not finished: continue it with hir reconstruct --resume")


def exported_asset(run):
    """The newest .glb of exports/, or None."""
    files = sorted(Path(run, "exports").glob("*.glb"), key=lambda file: (file.stat().st_mtime_ns, file.name))
    return files[-1] if files else None


def exported_light(asset):
    """The light beside an exported asset, or None."""
    beside = [asset.with_suffix(suffix) for suffix in LIGHTS]
    return next((file for file in beside if file.is_file()), None)
