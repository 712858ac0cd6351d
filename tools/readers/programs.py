"""Runs each reader as a program of its own: what it says about files, or why it was not run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

HERE: Final = Path(__file__).resolve().parent
ROOT: Final = HERE.parents[1]
TIMEOUT_SECONDS: Final = 600

Description = Mapping[str, Any]
"""`triangles`, `low`, `high`, `meshes`, `textures`, `ignored`; or `error`. See the programs."""


class NotRunError(Exception):
    """The reader is not installed, or its program failed as a whole."""


@dataclass(frozen=True)
class Reader:
    """A third-party reader."""

    name: str
    kinds: frozenset[str]
    """Kinds of files that it reads by its own documentation."""
    read: Callable[[Sequence[Path]], list[Description]]
    version: Callable[[], str]
    install: str
    """How to get it."""


def python_module_version(module: str) -> str:
    """Raises `NotRunError` where the module is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(module)
    except PackageNotFoundError as error:
        raise NotRunError(f"{module} is not installed") from error


def _assimp(files: Sequence[Path]) -> list[Description]:
    return _described([sys.executable, HERE / "read_assimp.py", *files])


def _trimesh(files: Sequence[Path]) -> list[Description]:
    return _described([sys.executable, HERE / "read_trimesh.py", *files])


def _gltf_transform(files: Sequence[Path]) -> list[Description]:
    return _described(["node", HERE / "read_gltf_transform.mjs", *files])


def _gltfpack(files: Sequence[Path]) -> list[Description]:
    """Each file is packed without quantisation, and the result is read by glTF-Transform."""
    with tempfile.TemporaryDirectory() as folder:
        packed, errors = [], {}
        for index, file in enumerate(files):
            output = Path(folder) / f"{index}.glb"
            command = ["node", HERE / "node_modules" / "gltfpack" / "cli.js", "-noq", "-kn", "-km", "-ke", "-i", file]
            done = subprocess.run([*map(str, command), "-o", str(output)], capture_output=True, text=True, check=False)
            if done.returncode or not output.is_file():
                errors[index] = {"error": " ".join((done.stderr or done.stdout).split())}
            else:
                packed.append(output)
        read = iter(_gltf_transform(packed))
        return [errors[index] if index in errors else next(read) for index in range(len(files))]


def _blender(files: Sequence[Path]) -> list[Description]:
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "found.json"
        _run([_blender_python(), HERE / "read_blender.py", output, *files])
        found: list[Description] = json.loads(output.read_text(encoding="utf-8"))
        return found


def _blender_python() -> Path:
    python = Path(os.environ.get("HIR_BLENDER_PYTHON", ROOT / ".venv-blender" / "bin" / "python"))
    if not python.exists():
        raise NotRunError("bpy is not installed")
    return python


def _blender_version() -> str:
    return _run([_blender_python(), "-c", "import bpy; print('version', bpy.app.version_string)"]).split("version ")[-1]


def _package_version(package: str) -> str:
    file = HERE / "node_modules" / package / "package.json"
    if not file.is_file():
        raise NotRunError(f"{package} is not installed")
    version: str = json.loads(file.read_text(encoding="utf-8"))["version"]
    return version


def _described(command: Sequence[object]) -> list[Description]:
    found: list[Description] = json.loads(_run(command))
    return found


def _run(command: Sequence[object]) -> str:
    try:
        done = subprocess.run(
            [str(word) for word in command], capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotRunError(f"{type(error).__name__}: {command[0]}") from error
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise NotRunError(f"its program ended with {done.returncode}: {lines[-1]}")
    return done.stdout.strip()


GLTF, USD, OBJ = "gltf", "usd", "obj"

READERS: Final = (
    Reader(
        "assimp-py",
        frozenset({GLTF, OBJ}),
        _assimp,
        lambda: python_module_version("assimp-py"),
        "pip install assimp-py",
    ),
    Reader("trimesh", frozenset({GLTF, OBJ}), _trimesh, lambda: python_module_version("trimesh"), "part of hir"),
    Reader(
        "glTF-Transform",
        frozenset({GLTF}),
        _gltf_transform,
        lambda: _package_version("@gltf-transform/core"),
        "npm --prefix tools/readers ci",
    ),
    Reader(
        "gltfpack",
        frozenset({GLTF}),
        _gltfpack,
        lambda: _package_version("gltfpack"),
        "npm --prefix tools/readers ci",
    ),
    Reader("Blender", frozenset({GLTF, USD, OBJ}), _blender, _blender_version, "tools/setup.sh blender"),
)
