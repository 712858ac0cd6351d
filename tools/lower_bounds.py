"""Installs hir[usd] with the oldest versions that pyproject.toml allows, and runs the tests that need nothing else.

    python tools/lower_bounds.py [FOLDER]

FOLDER gets the virtual environment (by default a temporary one). The base install with USD is tested: reading and
writing assets, `hir export`, `hir check`, plugins. Exit code 1 where a test fails.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
TESTS = [
    "tests/hir_exporters",
    "tests/hir_core/plugins/test_manager.py",
    "tests/reliability/test_hostile_files.py",
    "tests/reliability/test_hostile_images.py",
    "tests/reliability/test_hostile_meshes.py",
]
"""Hostile files too: what an old library opens, a new one may refuse."""

TOOLS = ["pytest", "hypothesis", "mpmath", "jsonschema", "scipy"]


def main() -> int:
    if len(sys.argv) > 1:
        return tested(Path(sys.argv[1]))
    with tempfile.TemporaryDirectory() as folder:
        return tested(Path(folder))


def lowest() -> list[str]:
    """`name==version` of each dependency of hir[usd], in the oldest allowed version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    bounds = []
    for line in [*project["dependencies"], *project["optional-dependencies"]["usd"]]:
        requirement = Requirement(line)
        [version] = [s.version for s in requirement.specifier if s.operator == ">="]
        bounds.append(f"{requirement.name}=={version}")
    return bounds


def tested(folder: Path) -> int:
    """Creates the environment and runs the tests; returns their exit code."""
    environment_folder = folder / "lower-bounds"
    venv.EnvBuilder(with_pip=True, clear=True).create(environment_folder)
    python = environment_folder / "bin" / "python"
    constraints = folder / "lowest.txt"
    constraints.write_text("\n".join(lowest()) + "\n")
    arguments = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--constraint", str(constraints)]
    subprocess.run([python, *arguments, f"{ROOT}[usd]", *TOOLS], check=True)
    print("\n".join(lowest()), flush=True)
    # old releases warn of what newer Pythons will take away: no fault of theirs or ours
    arguments = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "default", *TESTS]
    return subprocess.run([python, *arguments], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
