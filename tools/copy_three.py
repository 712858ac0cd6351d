"""Copies the files of three.js that `hir view` inlines, unchanged, from tools/node_modules into the package.

npm --prefix tools ci && python tools/copy_three.py
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "tools" / "node_modules" / "three"
TARGET = ROOT / "hir_core" / "viewer" / "three"

FILES = (
    "LICENSE",
    "build/three.core.js",
    "build/three.module.js",
    "examples/jsm/controls/OrbitControls.js",
    "examples/jsm/loaders/GLTFLoader.js",
    "examples/jsm/loaders/HDRLoader.js",
    "examples/jsm/utils/BufferGeometryUtils.js",
    "examples/jsm/utils/SkeletonUtils.js",
)
"""As the npm package names them; three.js is MIT-licensed."""


def copy() -> None:
    """Replaces the copies and notes the version."""
    TARGET.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        shutil.copyfile(SOURCE / name, TARGET / Path(name).name)
    version = json.loads((SOURCE / "package.json").read_text(encoding="utf-8"))["version"]
    (TARGET / "VERSION").write_text(f"{version}\n", encoding="utf-8")


if __name__ == "__main__":
    copy()
