"""Mutates each line of the numerical modules and counts the mutants that their tests detect (mutmut).

    python tools/mutation.py [conventions|materials|losses …] [--workspace FOLDER] [--children 1]

Works on a copy, where `hir_exporters` lies beside the other packages, as mutmut names modules by their path. Prints the
score of each module and every change that survived, with the line it changed. Needs mutmut (pip install 'hir[audit]').
What has been measured in FOLDER is not measured again.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SURVIVED = {0: "survived", 33: "no test", 5: "no test", None: "not measured"}
"""Exit codes of mutmut for surviving mutants; with all others a test failed or timed out."""


@dataclass(frozen=True)
class Subject:
    """Modules and the quick tests that must detect their mutants."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]


SUBJECTS = {
    "conventions": Subject(("hir_exporters/conventions.py",), ("tests/hir_exporters/test_conventions.py",)),
    "materials": Subject(
        ("hir_exporters/materials/material_conversion.py",),
        (
            "tests/hir_exporters/materials/test_material_conversion.py",
            "tests/hir_exporters/materials/test_metallic_mixture.py",
        ),
    ),
    "losses": Subject(
        (
            "hir_core/stages/reflectance/gradient_fit.py",
            "hir_core/scene/silhouette_targets.py",
            "hir_core/scene/energy_conservation.py",
            "hir_core/scene/srgb.py",
            "hir_core/optimization/weighted_energies.py",
        ),
        (
            "tests/hir_core/stages/reflectance/test_gradient_fit.py",
            "tests/hir_core/scene/test_energy_conservation.py",
            "tests/hir_core/scene/test_silhouettes_and_srgb.py",
        ),
    ),
}

SETTINGS = """
[tool.mutmut]
source_paths = ["hir_core", "hir_exporters", "hir_plugins"]
only_mutate = {modules}
also_copy = ["tools"]
pytest_add_cli_args = ["-p", "no:dash", "-p", "no:randomly", "--import-mode=importlib", "-m", "not slow and not gpu"]
pytest_add_cli_args_test_selection = {tests}
mutate_only_covered_lines = false
use_setproctitle = false
track_dependencies = false

[tool.pytest.ini_options]
pythonpath = ["tools", "."]
markers = ["slow: slow", "gpu: gpu"]
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("subjects", nargs="*", help=f"of {', '.join(SUBJECTS)}; by default all")
    parser.add_argument("--workspace", type=Path)
    parser.add_argument("--children", type=int, default=1)
    options = parser.parse_args()
    if unknown := set(options.subjects) - SUBJECTS.keys():
        parser.error(f"no subject {', '.join(sorted(unknown))}; there are {', '.join(SUBJECTS)}")
    with tempfile.TemporaryDirectory() as folder:
        place = options.workspace or Path(folder)
        measured = [measure(name, place / name, options.children) for name in options.subjects or SUBJECTS]
    return 0 if all(measured) else 1


def measure(name: str, place: Path, children: int) -> bool:
    """Prints the score of a subject and its surviving mutants; returns whether it was measured."""
    subject = SUBJECTS[name]
    copy(subject, place)
    paths = [str(place / "mutants"), str(place)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(paths)}
    arguments = [sys.executable, "-m", "mutmut", "run", "--max-children", str(children)]
    done = subprocess.run(arguments, cwd=place, env=environment, capture_output=True, text=True)
    if done.returncode:
        output_lines = [line for line in done.stdout.splitlines() if line[1:2] != " "]  # not the spinner's
        print(f"{name}: mutmut stopped early", *output_lines[-30:], done.stderr[-3000:], sep="\n")
        return False
    counted: Counter[str] = Counter()
    left: dict[str, str] = {}
    for module in subject.modules:
        record = json.loads((place / "mutants" / f"{module}.meta").read_text())
        for mutant, code in record["exit_code_by_key"].items():
            verdict = SURVIVED.get(code, "noticed")
            counted[verdict] += 1
            if verdict != "noticed":
                left[mutant] = verdict
    total = sum(counted.values())
    print(f"{name}: {counted['noticed']} of {total} changes noticed ({counted['noticed'] / max(total, 1):.1%})")
    changes = changed_lines(list(left), place, environment)
    for mutant, change in zip(left, changes, strict=True):
        print(f"  {left[mutant]}: {mutant}: {change}", flush=True)
    return True


def copy(subject: Subject, place: Path) -> None:
    """Copies the files for mutmut; unchanged files are not touched, so that their results stay valid."""
    # Python remembers that a folder of its path is not there: it must be before mutmut fills it
    (place / "mutants").mkdir(parents=True, exist_ok=True)
    folders = {"hir_core": ROOT / "hir_core", "hir_plugins": ROOT / "hir_plugins", "tests": ROOT / "tests"}
    folders |= {"hir_exporters": ROOT / "exporters" / "hir_exporters", "examples": ROOT / "examples"}
    for name, source in folders.items():
        for path in source.rglob("*"):
            target = place / name / path.relative_to(source)
            if path.is_file() and "__pycache__" not in path.parts and not same(path, target):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, target)
    shutil.copytree(
        ROOT / "tools" / "parity",
        place / "tools" / "parity",
        dirs_exist_ok=True,
        ignore=shutil.ignore_patterns("node_modules"),
    )
    settings = SETTINGS.format(modules=json.dumps(subject.modules), tests=json.dumps(subject.tests))
    (place / "pyproject.toml").write_text(settings)


def same(path: Path, other: Path) -> bool:
    """Whether both files have the same content."""
    return other.is_file() and path.read_bytes() == other.read_bytes()


SHOW = """
import sys
from mutmut.mutation.diff_apply import get_diff_for_mutant
for mutant in sys.argv[1:]:
    lines = [line for line in get_diff_for_mutant(mutant).splitlines() if line[:1] in "+-"]
    print(" → ".join(line[1:].strip() for line in lines if line[:3] not in ("+++", "---")))
"""


def changed_lines(mutants: list[str], place: Path, environment: dict[str, str]) -> list[str]:
    """The original and the mutated line of each mutant."""
    arguments = [sys.executable, "-c", SHOW, *mutants]
    return subprocess.run(
        arguments, cwd=place, env=environment, capture_output=True, text=True, check=True
    ).stdout.splitlines()


if __name__ == "__main__":
    sys.exit(main())
