"""Exports runs or scenes in every profile and format, and asks every validator: `validate_exports.py RUN|SCENE…`.

Khronos' validator for glTF, pxr.UsdValidation and omniverse-asset-validator for USD. Exit code 0 where none has an
error or a warning; what they call information (texture coordinates that no texture uses) is let pass, and so are the
ids of MaterialX, which usd-core does not know, in the layer that holds nothing else.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from hir_exporters.asset import Asset
from hir_exporters.configs import GltfConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.validators import Finding, validate_gltf, validate_omniverse, validate_usd
from hir_exporters.scene_format import load_scene

TOOLS: Final = Path(__file__).resolve().parent
PROFILES: Final = ("khr", "blender", "metalrough", "unity-legacy")


def main() -> int:
    """Prints what was found of each run."""
    words = argparse.ArgumentParser(prog="validate_exports", description=__doc__)
    words.add_argument("--no-nvidia", action="store_true", help="Leave out NVIDIA's rules: minutes for 50k triangles.")
    words.add_argument("sources", nargs="+", type=Path, metavar="RUN|SCENE")
    asked, bad = words.parse_args(), 0
    for source in asked.sources:
        scene = source if (source / "scene.json").is_file() else source / "scene"
        with tempfile.TemporaryDirectory() as folder:
            files = written(load_scene(scene), Path(folder))
            found = complaints(files, nvidia=not asked.no_nvidia)
        bad += len(found)
        print(f"{source}: {len(files)} files, {len(found)} complaints", flush=True)
        for finding in found:
            print(f"  {finding.file.name}: {finding.severity} {finding.code}: {finding.message}")
    return 1 if bad else 0


def written(asset: Asset, folder: Path) -> list[Path]:
    """The asset in every profile × format, and each option that changes a file's structure."""
    files = []
    for name, suffix, config in kinds():
        report = create_exporter(suffix, config).write(asset, folder / f"{name}.{suffix}")
        files += [f for f in report.files if f.suffix in (".glb", ".gltf", ".usda", ".usdc", ".usdz")]
    return files


def kinds() -> Iterator[tuple[str, str, Any]]:
    """Name, format and options of each file that is written."""
    for suffix in ("glb", "gltf"):
        for profile in PROFILES:
            yield profile, suffix, GltfConfig(profile=profile)
    yield "quantized", "glb", GltfConfig(quantize=True)
    yield "lit", "glb", GltfConfig(image_based_light=True)
    for name, library in (("draco", "DracoPy"), ("meshopt", "meshopt")):
        if find_spec(library):
            yield name, "glb", GltfConfig(compression=name)
    for workflow in ("metallic", "specular"):
        for suffix in ("usda", "usdc"):
            yield workflow, suffix, UsdConfig(workflow=workflow)
        yield workflow, "usdz", UsdzConfig(workflow=workflow, budget="none")
    yield "materialx", "usda", UsdConfig(materialx=True)


def complaints(files: list[Path], nvidia: bool = True) -> list[Finding]:
    """What the validators mind."""
    gltf = [file for file in files if file.suffix in (".glb", ".gltf")]
    usd = [file for file in files if file.suffix.startswith(".usd")]
    found = validate_gltf(gltf, TOOLS) + validate_usd(usd) + (validate_omniverse(usd) if nvidia else [])
    return [f for f in found if f.severity != "information" and not is_materialx(f)]


def is_materialx(finding: Finding) -> bool:
    """Whether usd-core only does not know an id of MaterialX, in the layer that may have them."""
    layer = finding.file.name.endswith("_openpbr.usda")
    return layer and finding.code == "MissingShaderIdInRegistry" and "ND_" in finding.message


if __name__ == "__main__":
    sys.exit(main())
