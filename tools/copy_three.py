"""Minifies the modules of three.js that `hir view` inlines, from tools/node_modules into the package.

    npm --prefix tools ci && python tools/copy_three.py

The npm release has no minified builds. Each module is minified on its own by terser, whose version and whose
dependencies tools/package-lock.json pins; nothing is bundled, patched or left out, and the licence comment stays.
terser is JavaScript without native parts, so every machine writes the same bytes. `manifest.json`, beside the files,
names the release, the minifier and the SHA-256 of every source and result; tests compare them.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
MODULES: Final = ROOT / "tools" / "node_modules"
TARGET: Final = ROOT / "hir_plugins" / "commands" / "viewer" / "page" / "three"

SOURCES: Final[Mapping[str, str]] = {
    "three.core.min.js": "build/three.core.js",
    "three.module.min.js": "build/three.module.js",
    "OrbitControls.min.js": "examples/jsm/controls/OrbitControls.js",
    "GLTFLoader.min.js": "examples/jsm/loaders/GLTFLoader.js",
    "HDRLoader.min.js": "examples/jsm/loaders/HDRLoader.js",
    "BufferGeometryUtils.min.js": "examples/jsm/utils/BufferGeometryUtils.js",
    "SkeletonUtils.min.js": "examples/jsm/utils/SkeletonUtils.js",
}
"""Minified file → source in the npm package. three.js is MIT-licensed."""

TERSER_OPTIONS: Final = ("--module", "--ecma", "2020", "--compress", "--mangle", "--comments", "/@license/")


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def package_version(name: str) -> str:
    """The version of an installed npm package."""
    return str(json.loads((MODULES / name / "package.json").read_text(encoding="utf-8"))["version"])


def minified(source: Path) -> bytes:
    """The minified text of a JavaScript module."""
    command = ["node", str(MODULES / "terser" / "bin" / "terser"), str(source), *TERSER_OPTIONS]
    return subprocess.run(command, check=True, capture_output=True).stdout


def write_minified(target: Path = TARGET) -> None:
    """Replaces the content of `target`: the minified modules, three.js' licence and the manifest."""
    package = MODULES / "three"
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    files = {}
    for name, source in SOURCES.items():
        content = minified(package / source)
        (target / name).write_bytes(content)
        source_hash = sha256((package / source).read_bytes())
        files[name] = {"sha256": sha256(content), "source": source, "source_sha256": source_hash}
    licence = (package / "LICENSE").read_bytes()
    (target / "LICENSE").write_bytes(licence)
    files["LICENSE"] = {"sha256": sha256(licence), "source": "LICENSE", "source_sha256": sha256(licence)}
    manifest = {"three": package_version("three"), "terser": package_version("terser"), "files": files}
    (target / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_minified()
