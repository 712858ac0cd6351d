"""Exporters with one fault each, made of the built-in ones."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.asset import Asset, AssetMesh, validate_asset
from hir_exporters.exporter import Edit, Exporter, ExportReport
from hir_exporters.files.atomic import write_bytes_atomic
from hir_exporters.format_options import ObjConfig, UsdConfig
from hir_exporters.mesh.ply_format import encode_ply
from hir_exporters.obj.obj_exporter import ObjExporter
from hir_exporters.usd.usd_exporter import UsdExporter

from hir_core.plugins import Component
from hir_core.testing.assets import ball

HERE = __name__


class Obj(Exporter):
    """The sound one without a document."""

    def __init__(self, config: ObjConfig) -> None:
        self.inner = ObjExporter(config)

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return self.inner.write(asset, destination, edit)


class KeepsALog(Obj):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        report = super().write(asset, destination, edit)
        (destination.parent.parent / "export.log").write_text("written\n")
        return report


class Dated(Obj):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        report = super().write(asset, destination, edit)
        destination.write_text(f"# {int(time.time())}\n{destination.read_text()}")
        return report


class Sideways(Obj):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        turned = replace(asset.mesh, positions=asset.mesh.positions[:, [0, 2, 1]])
        return super().write(replace(asset, mesh=turned), destination, edit)


class WritesFirst(Obj):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        if not destination.exists():
            destination.parent.mkdir(parents=True, exist_ok=True)
            destination.write_text("")
        return super().write(asset, destination, edit)


class Rewritten(Obj):
    """Changes the text of the files that it wrote."""

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        report = super().write(asset, destination, edit)
        for file in report.files[:2]:
            lines = file.read_text().splitlines()
            file.write_text("\n".join(self.changed(line) for line in lines) + "\n")
        return report

    def changed(self, line: str) -> str:
        return line


class DownwardV(Rewritten):
    def changed(self, line: str) -> str:
        word, *numbers = line.split() or [""]
        return f"vt {numbers[0]} {1 - float(numbers[1])}" if word == "vt" else line


class InwardNormals(Rewritten):
    def changed(self, line: str) -> str:
        word, *numbers = line.split() or [""]
        return " ".join(["vn", *(str(-float(number)) for number in numbers)]) if word == "vn" else line


class NamesNoPicture(Rewritten):
    def changed(self, line: str) -> str:
        return "map_Kd no_such_picture.png" if line.startswith("map_Kd") else line


class NamesNoMaterials(Rewritten):
    def changed(self, line: str) -> str:
        return "mtllib no_such_library.mtl" if line.startswith("mtllib") else line


class OnlyPositions(Rewritten):
    def changed(self, line: str) -> str:
        word, *corners = line.split() or [""]
        left_out = word in ("vt", "vn", "mtllib")
        return "" if left_out else f"f {' '.join(c.split('/')[0] for c in corners)}" if word == "f" else line


class Ply(Exporter):
    """Positions, normals and texture coordinates."""

    warnings: tuple[str, ...] = ("the material is not written",)

    def __init__(self, config: ObjConfig) -> None:
        pass

    def mesh(self, mesh: AssetMesh) -> AssetMesh:
        return mesh

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        validate_asset(asset)
        write_bytes_atomic(destination, encode_ply(self.mesh(asset.mesh)))
        return ExportReport((destination,), self.warnings)


class PlyDownwardV(Ply):
    def mesh(self, mesh: AssetMesh) -> AssetMesh:
        return replace(mesh, uvs=mesh.uvs * [1, -1] + [0, 1])


class PlyInwardNormals(Ply):
    def mesh(self, mesh: AssetMesh) -> AssetMesh:
        return replace(mesh, normals=-mesh.normals)


class PlyWithoutAWord(Ply):
    warnings = ()


class Corners(Ply):
    """Positions alone, in a format that no library reads."""

    warnings = ()

    def content(self, mesh: AssetMesh) -> np.ndarray:
        return mesh.positions[mesh.faces].reshape(-1, 9)

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        validate_asset(asset)
        write_bytes_atomic(destination, self.content(asset.mesh).astype(np.float64).tobytes())
        return ExportReport((destination,), self.warnings)


class CornersWithAWarning(Corners):
    warnings = ("texture coordinates, normals and material are not written",)


class CornersWithNormals(Corners):
    def content(self, mesh: AssetMesh) -> np.ndarray:
        return np.concatenate([mesh.positions[mesh.faces], mesh.normals[mesh.faces]]).reshape(-1, 9)


def read_corners(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of what `Corners` wrote."""
    count = len(ball().faces)
    positions = np.frombuffer(path.read_bytes()).reshape(-1, 3)[: 3 * count]
    return positions, np.arange(3 * count).reshape(-1, 3)


class OneWarning(Obj):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return replace(super().write(asset, destination, edit), warnings="roughness is not written")  # type: ignore[arg-type]


class NoReport(Obj):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        super().write(asset, destination, edit)
        return None  # type: ignore[return-value]


class Usd(Exporter):
    """The sound one with a document."""

    def __init__(self, config: UsdConfig) -> None:
        self.inner = UsdExporter(config)

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return self.inner.write(asset, destination, edit)


class Deaf(Usd):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return super().write(asset, destination, None)


class Invalid(Usd):
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        def spoilt(stage: Any, written: Asset) -> None:
            from pxr import UsdGeom

            # a mesh inside of a mesh: usdGeom's rules of encapsulation forbid it
            mesh = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
            stage.DefinePrim(mesh.GetPath().AppendChild("inner"), "Sphere")
            if edit is not None:
                edit(stage, written)

        return super().write(asset, destination, spoilt)


def obj(implementation: type = Obj) -> Component:
    return made("obj", implementation, ObjConfig, "OBJ, wrapped.")


def ply(implementation: type = Ply) -> Component:
    return made("ply", implementation, ObjConfig, "PLY.")


def corners(implementation: type) -> Component:
    return replace(made("corners", implementation, ObjConfig, "Corners."), testing=f"{HERE}:read_corners")


def usda(implementation: type = Usd) -> Component:
    return made("usda", implementation, UsdConfig, "USD, wrapped.", frozenset({"usd"}))


def made(
    name: str, implementation: type, config: type, summary: str, traits: frozenset[str] = frozenset()
) -> Component:
    """Both kinds are in this file, which imports USD."""
    target = f"{HERE}:{implementation.__name__}"
    return Component(name, target, config, summary, traits=traits, requires=("pxr",), extra="usd")


BROKEN_EXPORTERS: dict[str, Component] = {
    "writes_below_its_destination": obj(KeepsALog),
    "same_bytes_twice": obj(Dated),
    "reads_back": obj(Sideways),
    "bad_input_writes_nothing": obj(WritesFirst),
    "validators_find_nothing": usda(Invalid),
    "edit_is_called_once": usda(Deaf),
}
