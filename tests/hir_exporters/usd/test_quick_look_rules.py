"""The rules of usdchecker's former option --arkit, which no library checks as a whole any more.

OpenUSD 26 has the general ones as validators (`PACKAGE_VALIDATORS`). The others are stated here: what a package for AR
Quick Look may contain. No device was tried.
"""

from __future__ import annotations

import zipfile
from pathlib import Path, PurePosixPath

import pytest
from hir_exporters.asset import Asset
from hir_exporters.format_options import UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.validators import validate_usd
from pxr import Usd, UsdGeom, UsdShade, UsdValidation

PACKAGE_VALIDATORS = {
    "usdUtilsValidators:UsdzPackageValidator",  # stored without compression, aligned to 64 bytes
    "usdUtilsValidators:RootPackageValidator",
    "usdUtilsValidators:PackageEncapsulationValidator",  # nothing outside of the package is named
    "usdUtilsValidators:FileExtensionValidator",
    "usdUtilsValidators:MissingReferenceValidator",
    "usdGeomValidators:StageMetadataChecker",  # an up axis and metres
    "usdValidation:StageMetadataChecker",  # a default prim
    "usdShadeValidators:NormalMapTextureValidator",  # scale, bias and raw colours of normal maps
    "usdShadeValidators:MaterialBindingApiAppliedValidator",
    "usdShadeValidators:ShaderSdrCompliance",
}

PRIM_TYPES = {"", "Xform", "Scope", "Mesh", "Material", "Shader", "GeomSubset"}
SHADERS = {"UsdPreviewSurface", "UsdUVTexture", "UsdTransform2d"}
TEXTURES = {".png", ".jpg", ".jpeg"}


def rule_breaks(package: Path) -> set[str]:
    """What a package contains that AR Quick Look does not read; empty where there is nothing."""
    found = set()
    with zipfile.ZipFile(package) as files:
        names = files.namelist()
    if PurePosixPath(names[0]).suffix != ".usdc":
        found.add(f"the first file is {names[0]}, not a .usdc layer")
    found |= {f"the file {n}" for n in names[1:] if PurePosixPath(n).suffix.lower() not in TEXTURES}
    stage = Usd.Stage.Open(str(package))
    if UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.y:
        found.add("the up axis is not Y")
    if not stage.GetDefaultPrim():
        found.add("there is no default prim")
    for prim in stage.TraverseAll():
        if str(prim.GetTypeName()) not in PRIM_TYPES:
            found.add(f"a prim of type {prim.GetTypeName()}")
        if prim.IsA(UsdShade.Shader):
            kind = str(UsdShade.Shader(prim).GetIdAttr().Get())
            if not (kind in SHADERS or kind.startswith("UsdPrimvarReader_")):
                found.add(f"a shader {kind}")
        if prim.IsA(UsdGeom.Mesh) and not UsdShade.MaterialBindingAPI(prim).GetDirectBinding().GetMaterial():
            found.add(f"no material at {prim.GetPath()}")
    return found


def test_openusd_has_the_validators_that_the_documentation_names() -> None:
    names = {str(v.name) for v in UsdValidation.ValidationRegistry().GetAllValidatorMetadata()}
    assert names >= PACKAGE_VALIDATORS


@pytest.mark.parametrize("workflow", ["metallic", "specular"])
@pytest.mark.parametrize("image_format", ["png", "jpeg"])
@pytest.mark.parametrize("kind", ["textured_asset", "constant_asset"])
def test_packages_keep_the_rules(
    kind: str, image_format: str, workflow: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    asset: Asset = request.getfixturevalue(kind)
    config = UsdzConfig(workflow=workflow, image_format=image_format, thumbnail=True)  # type: ignore[arg-type]
    create_exporter("usdz", config).write(asset, tmp_path / "x.usdz")
    assert rule_breaks(tmp_path / "x.usdz") == set()
    assert validate_usd([tmp_path / "x.usdz"]) == []


def test_what_breaks_the_rules_is_found(textured_asset: Asset, tmp_path: Path) -> None:
    path, broken = tmp_path / "x.usdz", tmp_path / "broken.usdz"

    def add_light(stage: Usd.Stage, asset: Asset) -> None:
        stage.DefinePrim("/light", "DomeLight")

    create_exporter("usdz").write(textured_asset, path, add_light)
    assert rule_breaks(path) == {"a prim of type DomeLight"}
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(broken, "w", zipfile.ZIP_STORED) as target:
        for name in source.namelist():
            target.writestr(name, source.read(name))
    assert "ByteMisalignment" in {finding.code for finding in validate_usd([broken])}
