"""Contracts of exporters: where they write, what they write, and that it can be read again."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.asset import Asset
from hir_exporters.errors import ExportError, HirError, InputError
from hir_exporters.exporter import ExportReport

from hir_core.plugins.registration import a_value
from hir_core.testing.assets import constant_asset, textured_asset
from hir_core.testing.contract import BrokenContract, NotApplicable, Subject, contract, require
from hir_core.testing.exercise import digest
from hir_core.testing.mesh_files import MeshFile, read_mesh_file, surface_by_trimesh

SURFACES = (".obj", ".ply", ".stl", ".off")
LIGHTS = (".hdr", ".exr")


def _assets(subject: Subject) -> list[Asset]:
    """A textured asset with a light; one of constants without, unless the light alone is written."""
    return [textured_asset()] if subject.has("environment") else [textured_asset(), constant_asset()]


def _write(subject: Subject, asset: Asset, folder: Path) -> ExportReport:
    report: object = subject.create().write(asset, folder / f"a ball.{subject.component.name}")
    if not isinstance(report, ExportReport):
        raise BrokenContract(f"write returns {a_value(report)}; return an ExportReport")
    if isinstance(report.warnings, str):
        raise BrokenContract("the warnings of its report are text; write a tuple of sentences: warnings=(sentence,)")
    return report


def _bytes(folder: Path) -> dict[str, bytes]:
    return {f.relative_to(folder).as_posix(): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@contract("exporter")
def writes_below_its_destination(subject: Subject) -> None:
    """The folder of the destination is made where it is missing. All files lie beside the destination or below its
    folder, all of them are in the report, the destination first; nothing temporary stays, and the asset is not changed.
    """
    for asset in _assets(subject):
        root = subject.folder()
        (root / "neighbour.txt").write_text("mine", encoding="utf-8")
        before = digest(asset)
        try:
            report = _write(subject, asset, root / "out")
        except (FileNotFoundError, ExportError) as error:
            (root / "out").mkdir(exist_ok=True)
            _write(subject, asset, root / "out")  # another error than that of the folder is raised here
            raise BrokenContract(
                f"it raises {type(error).__name__} where the folder of its destination is not there yet; "
                "make it: destination.parent.mkdir(parents=True, exist_ok=True)"
            ) from error
        subject.memory.setdefault("written", (time.time(), _bytes(root / "out")))
        require(digest(asset) == before, "the asset that was passed in is not what it was before")
        there = set(_bytes(root)) - {"neighbour.txt"}
        outside = sorted(name for name in there if not name.startswith("out/"))
        require(
            not outside,
            f"it writes {', '.join(outside)}, outside of the folder of its destination; write below destination.parent",
        )
        listed = [Path(f).resolve() for f in report.files]
        require(
            listed and listed[0] == root / "out" / f"a ball.{subject.component.name}",
            f"the first file of the report is {listed[0] if listed else 'missing'}, not the destination",
        )
        unlisted = sorted(there - {f.relative_to(root).as_posix() for f in listed if f.is_relative_to(root)})
        require(not unlisted, f"it writes {', '.join(unlisted)}, which its report does not list")
        missing = [f.name for f in listed if not f.is_file()]
        require(not missing, f"its report lists {', '.join(missing)}, which is not there")
        require((root / "neighbour.txt").read_text(encoding="utf-8") == "mine", "it changed a neighbour's file")


@contract("exporter")
def same_bytes_twice(subject: Subject) -> None:
    """The bytes are a pure function of asset and options: written again a second later elsewhere, they are equal."""
    asset, folder = _assets(subject)[0], subject.folder()
    if "written" not in subject.memory:
        first = subject.folder()
        _write(subject, asset, first)
        subject.memory["written"] = (time.time(), _bytes(first))
    began, one = subject.memory["written"]
    # a time stamp of whole seconds has to differ
    time.sleep(max(0.0, 1.05 - (time.time() - began)))
    _write(subject, asset, folder)
    two = _bytes(folder)
    require(set(one) == set(two), f"first it writes {', '.join(one)}, then {', '.join(two)}")
    different = [name for name in one if one[name] != two[name]]
    require(
        not different,
        f"{', '.join(different)} has other bytes when it is written again; leave out the time, random names and orders",
    )


@contract("exporter")
def reads_back(subject: Subject) -> None:
    """An independent reader finds the asset in the file: trimesh, pygltflib and pxr by the file's ending, or the
    plugin's `testing` function, `function(path) -> (positions (V, 3), faces (F, 3))`. Texture coordinates and normals
    in an .obj or .ply file are those of the asset, with v upwards, and the files that it and its materials name are
    there. Where an .obj, .ply, .stl or .off file has no texture coordinates, normals or material, the report has a
    warning. So does that of an exporter with a `testing` function where no byte of its files depends on one of these.
    """
    for asset in _assets(subject):
        report = _write(subject, asset, subject.folder())
        path = report.files[0]
        if subject.testing is not None:
            _same_surface(asset, *subject.testing(path))
            _names_what_changes_nothing(subject, asset, report)
            continue
        _read_by_ending(path, asset)
        if path.suffix.lower() in SURFACES:
            file = read_mesh_file(path)
            _same_corners(asset, file)
            has = {"texture coordinates": file.uvs is not None, "normals": file.normals is not None}
            lost = [name for name, there in {**has, "material": file.has_material}.items() if not there]
            require(
                not lost or report.warnings,
                f"the file has no {' and no '.join(lost)}, and its report has no warning; write them, or name in "
                "`warnings` what is left out",
            )


def _names_what_changes_nothing(subject: Subject, asset: Asset, report: ExportReport) -> None:
    """A file of a format that is not known here is written again with other properties of its surface."""
    if report.warnings:
        return
    mesh, material = asset.mesh, asset.material
    changed = {
        "texture coordinates": replace(asset, mesh=replace(mesh, uvs=mesh.uvs * 0.5)),
        "normals": replace(asset, mesh=replace(mesh, normals=-mesh.normals)),
        "material": replace(asset, material=replace(material, diffuse_albedo=material.diffuse_albedo * 0.5)),
    }
    written = _bytes(report.files[0].parent)
    lost = []
    for name, other in changed.items():
        folder = subject.folder()
        _write(subject, other, folder)
        if _bytes(folder) == written:
            lost.append(name)
    require(
        not lost,
        f"no byte depends on its {' and its '.join(lost)}, and its report has no warning; write them, or name in "
        "`warnings` what is left out",
    )


def _read_by_ending(path: Path, asset: Asset) -> None:
    from hir_exporters.reading.file_verification import READERS, verify_file

    suffix = path.suffix.lower()
    if suffix in READERS:
        problems = verify_file(path, asset).problems
        require(not problems, "; ".join(problems))
    elif suffix in SURFACES:
        _same_surface(asset, *surface_by_trimesh(path))
    elif suffix in LIGHTS:
        from hir_exporters.textures.image_files import read_hdr

        assert asset.environment is not None
        truth, found = asset.environment.radiance, read_hdr(path)
        require(found.shape == truth.shape, f"the light is {found.shape}, not {truth.shape}")
        difference = float((np.abs(found - truth).max(axis=-1) / truth.max(axis=-1)).max())
        require(difference < 0.01, f"a texel of the light is {100 * difference:.1f} % from its radiance")
    else:
        require(
            False,
            f"no reader for {path.suffix!r} is known here; testing= must name a function(path) -> (positions, faces)",
        )


def _same_surface(asset: Asset, positions: np.ndarray, faces: np.ndarray) -> None:
    """The same triangles, in any order of vertices and faces."""
    require(
        len(faces) == len(asset.mesh.faces), f"{len(asset.mesh.faces)} triangles were written, {len(faces)} are read"
    )
    truth, found = (_triangles(p, f) for p, f in ((asset.mesh.positions, asset.mesh.faces), (positions, faces)))
    difference = float(np.abs(truth - found).max())
    size, found_size = (float(np.ptp(p.reshape(-1, 3), axis=0).max()) for p in (truth, found))
    times = found_size / size
    require(
        0.99 < times < 1.01,
        f"what is read back is {times:.4g} times as large as the asset: another unit of length; positions are in "
        "metres",
    )
    require(
        difference < 1e-4,
        f"a corner is {difference:.3g} from where it was: other axes, or fewer digits; +Y is up, right-handed",
    )


def _same_corners(asset: Asset, file: MeshFile) -> None:
    """Texture coordinates and normals of the file at the corners of the asset's triangles, where it has them."""
    require(not file.missing, f"it names {', '.join(file.missing)}, which it does not write")
    mesh = asset.mesh
    truth: dict[str, Any] = {"texture coordinates": mesh.uvs * [1, -1] + [0, 1], "normals": mesh.normals}
    advice = {
        "texture coordinates": "v of an asset points down, v of the format up: write 1 - v",
        "normals": "they point outwards and have the length 1",
    }
    keys = _corner_keys(np.asarray(mesh.positions, np.float64)[mesh.faces])
    found_keys = _corner_keys(file.positions)
    for name, found in (("texture coordinates", file.uvs), ("normals", file.normals)):
        if found is None:
            continue
        expected: dict[tuple[float, ...], list[np.ndarray]] = {}
        for key, value in zip(keys, truth[name][mesh.faces].reshape(len(keys), -1), strict=True):
            expected.setdefault(key, []).append(value)
        off = max(
            min((float(np.abs(value - one).max()) for one in expected.get(key, [])), default=0.0)
            for key, value in zip(found_keys, found.reshape(len(found_keys), -1), strict=True)
        )
        require(off < 1e-3, f"{name} of a corner are off by {off:.3g}; {advice[name]}")


def _corner_keys(corners: np.ndarray) -> list[tuple[float, ...]]:
    """The positions (F, 3, 3) of corners and of their triangles' centres, as keys."""
    centres = np.repeat(corners.mean(axis=1, keepdims=True), 3, axis=1)
    rounded = np.round(np.concatenate([corners, centres], axis=2).reshape(-1, 6), 3) + 0.0
    return [tuple(row) for row in rounded.tolist()]


def _triangles(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Corners of all triangles, each beginning at its least corner, in an order of their own."""
    corners = np.asarray(positions, np.float64)[np.asarray(faces)]
    rounded = np.round(corners, 4) + 0.0
    turned = []
    for exact, near in zip(corners, rounded, strict=True):
        start = min(range(3), key=lambda i: tuple(near[i]))
        turned.append(np.roll(exact, -start, axis=0).reshape(-1))
    order = np.lexsort(np.round(np.array(turned), 4).T[::-1])
    return np.array(turned)[order]


@contract("exporter")
def validators_find_nothing(subject: Subject) -> None:
    """Outside validators report no error: pxr's for USD, Khronos' for glTF where node and the package are installed."""
    from hir_exporters.reading.validators import validate_gltf, validate_usd

    files = [_write(subject, asset, subject.folder()).files[0] for asset in _assets(subject)]
    if subject.has("usd"):
        found = validate_usd(files)
    elif subject.has("gltf"):
        tools = next(
            (
                p / "tools"
                for p in (Path.cwd(), *Path.cwd().parents)
                if (p / "tools" / "node_modules" / "gltf-validator").is_dir()
            ),
            None,
        )
        if tools is None or shutil.which("node") is None:
            raise NotApplicable("node or its package gltf-validator is not installed beside tools/validate_gltf.cjs")
        found = validate_gltf(files, tools)
    else:
        raise NotApplicable("no validator is known for the format")
    errors = [f"{f.file.name}: {f.code}: {f.message}" for f in found if f.severity == "error"]
    require(not errors, "; ".join(errors))


@contract("exporter")
def edit_is_called_once(subject: Subject) -> None:
    """With the trait `gltf` or `usd`, `edit(document, asset)` is called once with the finished document, and what it
    changes is in the file; without, `edit=None` is all that is passed.
    """
    if not (subject.has("gltf") or subject.has("usd")):
        raise NotApplicable("it declares no document that can be edited")
    calls: list[str] = []

    def edit(document: Any, asset: Asset) -> None:
        calls.append(f"{type(document).__module__.partition('.')[0]}.{type(document).__name__}")
        if subject.has("gltf"):
            document.asset.copyright = "edited by a contract test"
        else:
            document.GetRootLayer().documentation = "edited by a contract test"

    folder, plain = subject.folder(), subject.folder()
    exporter = subject.create()
    exporter.write(textured_asset(), folder / f"ball.{subject.component.name}", edit)
    exporter.write(textured_asset(), plain / f"ball.{subject.component.name}")
    wanted = "pygltflib.GLTF2" if subject.has("gltf") else "pxr.Stage"
    require(calls == [wanted], f"edit is called with {calls or 'nothing'}; once with a {wanted} is needed")
    name = f"ball.{subject.component.name}"
    require(_bytes(folder)[name] != _bytes(plain)[name], "what edit changed in the document is not in the file")


@contract("exporter")
def bad_input_writes_nothing(subject: Subject) -> None:
    """An asset that is not finite is an `InputError`, a destination that cannot be written an `ExportError`; both name
    what is wrong, and neither leaves a file.
    """
    sound = textured_asset()
    broken = sound.mesh.positions.copy()
    broken[0, 0] = np.nan
    light = None if sound.environment is None else sound.environment.radiance.copy()
    assert light is not None and sound.environment is not None
    light[0, 0, 0] = np.nan
    bad = replace(sound, mesh=replace(sound.mesh, positions=broken))
    if subject.has("environment"):
        bad = replace(sound, environment=replace(sound.environment, radiance=light))
    folder = subject.folder()
    _refuses(subject, bad, folder / f"ball.{subject.component.name}", InputError, "an asset with NaN")
    require(not _bytes(folder), f"after an asset with NaN it leaves {', '.join(_bytes(folder))}")
    (folder / f"ball.{subject.component.name}").mkdir()
    _refuses(
        subject, sound, folder / f"ball.{subject.component.name}", ExportError, "a folder in the destination's place"
    )


def _refuses(subject: Subject, asset: Asset, destination: Path, wanted: type[HirError], what: str) -> None:
    try:
        subject.create().write(asset, destination)
    except wanted as error:
        require(len(str(error)) > 15, f"{what} raises {wanted.__name__}({str(error)!r}), which says nothing")
        return
    except Exception as error:
        require(False, f"{what} raises {type(error).__name__}: {error}; an {wanted.__name__} is needed")
    require(False, f"{what} is written without an error")
