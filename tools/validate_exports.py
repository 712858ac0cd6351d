"""Exports runs or scenes in every profile and format and runs all validators: `validate_exports.py RUN|SCENE…`.

The validators are Khronos' for glTF, and pxr.UsdValidation and omniverse-asset-validator for USD. The exit code is 0 if
none reports an error or a warning. Information (texture coordinates that no texture uses) is ignored, and so are the
shader identifiers of MaterialX, which usd-core does not know, in the layer that contains nothing else.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from hir_exporters.asset import Asset
from hir_exporters.format_options import GltfConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.validators import Finding, validate_gltf, validate_omniverse, validate_usd
from hir_exporters.scene_format import load_scene

TOOLS: Final = Path(__file__).resolve().parent
PROFILES: Final = ("khr", "blender", "metalrough", "unity-legacy", "engine")


Validators = Callable[[list[Path], bool], list[Finding]]


def main(arguments: Sequence[str] | None = None, validators: Validators | None = None) -> int:
    """Prints the problems of each run; returns the exit code. `validators` replaces `validate`."""
    parser = argparse.ArgumentParser(prog="validate_exports", description=__doc__)
    parser.add_argument("--no-nvidia", action="store_true", help="Skip NVIDIA's rules: minutes for 50k triangles.")
    parser.add_argument("sources", nargs="+", type=Path, metavar="RUN|SCENE")
    options, problem_count = parser.parse_args(arguments), 0
    for source in options.sources:
        scene = source if (source / "scene.json").is_file() else source / "scene"
        with tempfile.TemporaryDirectory() as folder:
            files = export_variants(load_scene(scene), Path(folder))
            found = problems((validators or validate)(files, not options.no_nvidia))
        problem_count += len(found)
        print(f"{source}: {len(files)} files, {len(found)} problems", flush=True)
        for finding in found:
            print(f"  {finding.file.name}: {finding.severity} {finding.code}: {finding.message}")
    return 1 if problem_count else 0


def export_variants(asset: Asset, folder: Path) -> list[Path]:
    """Exports the asset in every profile × format and with each option that changes a file's structure."""
    files = []
    for name, suffix, config in variants():
        report = create_exporter(suffix, config).write(asset, folder / f"{name}.{suffix}")
        files += [f for f in report.files if f.suffix in (".glb", ".gltf", ".usda", ".usdc", ".usdz")]
    return files


def variants() -> Iterator[tuple[str, str, GltfConfig | UsdConfig]]:
    """Name, format and options of each export."""
    for suffix in ("glb", "gltf"):
        for profile in PROFILES:
            yield profile, suffix, GltfConfig(profile=profile)
    yield "point_lights", "glb", GltfConfig(profile="engine", light_type="point")
    yield "quantized", "glb", GltfConfig(quantize=True)
    yield "lit", "glb", GltfConfig(image_based_light=True)
    yield "xmp", "glb", GltfConfig(xmp=True)
    for name, library in (("draco", "DracoPy"), ("meshopt", "meshopt")):
        if find_spec(library):
            yield name, "glb", GltfConfig(compression="draco" if name == "draco" else "meshopt")
    for workflow in ("metallic", "specular"):
        for suffix in ("usda", "usdc"):
            yield workflow, suffix, UsdConfig(workflow=workflow)
        yield workflow, "usdz", UsdzConfig(workflow=workflow, budget="none")
    yield "engine", "usda", UsdConfig(profile="engine")
    yield "materialx", "usda", UsdConfig(materialx=True)


def validate(files: list[Path], nvidia: bool = True) -> list[Finding]:
    """The findings of all validators."""
    gltf = [file for file in files if file.suffix in (".glb", ".gltf")]
    usd = [file for file in files if file.suffix.startswith(".usd")]
    return validate_gltf(gltf, TOOLS) + validate_usd(usd) + (validate_omniverse(usd) if nvidia else [])


def problems(findings: Iterable[Finding]) -> list[Finding]:
    """Errors and warnings, without the identifiers of MaterialX in its own layer."""
    return [f for f in findings if f.severity != "information" and not is_materialx(f)]


def is_materialx(finding: Finding) -> bool:
    """Whether the finding is only that usd-core does not know a MaterialX identifier, in the layer that has them."""
    layer = finding.file.name.endswith("_openpbr.usda")
    return layer and finding.code == "MissingShaderIdInRegistry" and "ND_" in finding.message


if __name__ == "__main__":
    sys.exit(main())
