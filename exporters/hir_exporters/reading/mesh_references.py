"""Loads mesh files of others, after a check of all that they name: .obj with `wavefront`, all others with trimesh.

A file may name other files: buffers, images, material libraries. All must be regular files in the folder of the file,
also after percent-decoding and after links are resolved; images must be of the formats that `open_image` reads. The
check is made before a library sees the file, and again when the library asks for one of these files.
"""

from __future__ import annotations

import base64
import binascii
import io
import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote

from hir_exporters.errors import HirError, InputError
from hir_exporters.files.regular_files import check_regular_file
from hir_exporters.files.untrusted_json import parse_json
from hir_exporters.reading.gltf_geometry.geometry_alone import geometry_alone, split_document
from hir_exporters.reading.gltf_geometry.required_extensions import check_required_extensions
from hir_exporters.reading.wavefront.mtl_statements import TEXTURES, read_library, texture_map
from hir_exporters.reading.wavefront.obj_geometry import read_obj
from hir_exporters.reading.wavefront.obj_mesh import trimesh_scene
from hir_exporters.reading.wavefront.obj_statements import library_names
from hir_exporters.textures.ktx2 import IDENTIFIER, check_ktx2
from hir_exporters.textures.pillow_images import open_image

if TYPE_CHECKING:
    import trimesh

SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
"""Formats that `load_mesh_scene` reads."""

MAX_NODES: Final = 10_000
"""Nodes of a glTF scene, and primitives of all its nodes together; trimesh needs about a millisecond for each."""

MAX_ELEMENTS: Final = 50_000_000
"""Elements of one glTF accessor, and corners of all instances of all meshes together."""

MAX_CORNERS: Final = 10_000
"""Corners of one polygon of an .obj: the time of its triangulation grows with their square."""

MAX_INDEX_LENGTH: Final = 60
"""Characters of one corner `v/vt/vn` of an .obj."""

_LONG_LINE: Final = 4 * MAX_INDEX_LENGTH
_ADDRESS: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")


def load_mesh_scene(
    path: Path, file: Any = None, kind: str = "", stored_uvs: bool = False, process: bool = True
) -> trimesh.Scene:
    """The scene of a mesh file; with `process` trimesh joins equal vertices.

    The materials of a glTF or an .obj are empty there: read them from the document or the library. With `stored_uvs`
    the meshes of a glTF have the attribute `STORED_UVS` where their texture coordinates are floats.

    `file` and `kind` are a stream and its format that replace the content of a checked file. Raises `InputError` where
    the file or one that it names is refused; trimesh's own errors are of many types.
    """
    import trimesh

    check_references(path)
    if path.suffix.lower() == ".obj":
        return trimesh_scene(read_obj(path), process)
    source = path if file is None else file
    kind = kind or path.suffix[1:].lower()
    if kind in ("glb", "gltf"):
        source = io.BytesIO(geometry_alone(path.read_bytes() if file is None else file.read(), stored_uvs))
    return trimesh.load_scene(source, file_type=kind, resolver=_contained_resolver(path), process=process)


def check_references(path: Path) -> None:
    """Raises `InputError` where the file names something that it must not name, or would expand to too much."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path} is not a mesh format that can be read; known are {', '.join(SUFFIXES)}")
    check_regular_file(path)
    if suffix in (".gltf", ".glb"):
        _check_gltf(path)
    elif suffix == ".obj":
        _check_obj(path)


def contained_file(owner: Path, name: str, percent_encoded: bool = False) -> Path:
    """The path of `name`, which the file `owner` names, in its folder. The file may be missing.

    Absolute paths, addresses such as `file:`, and names that lead out of the folder raise `InputError`, also where they
    do so only after percent-decoding; so does what is not a regular file.
    """
    shown = repr(name[:80])
    for form in (name, unquote(name), unquote(unquote(name))):
        if _ADDRESS.match(form) or form.startswith(("/", "\\")) or PureWindowsPath(form).drive:
            raise InputError(f"{owner} names {shown}, which is not relative to its folder; put the file beside it")
        try:
            form.encode()
            file = owner.parent / form.replace("\\", "/")
            contained = file.resolve().is_relative_to(owner.parent.resolve())
            unusable = not form.strip() or (file.exists() and not file.is_file())
        except (OSError, RuntimeError, ValueError) as error:  # a null character, half a character, a cycle of links
            if getattr(error, "strerror", None) == "File name too long":
                continue  # it names no file
            raise InputError(f"{owner} names {shown}, which is not a file name ({type(error).__name__})") from None
        if not contained:
            raise InputError(f"{owner} names {shown}, which is outside its folder; put the file beside it")
        if unusable:
            raise InputError(f"{owner} names {shown}, which is not a regular file; put the file beside it")
    return owner.parent / (unquote(name) if percent_encoded else name).replace("\\", "/")


def _contained_resolver(path: Path) -> Any:
    """trimesh's interface to the files that a mesh file names; `get` is called for images, `[]` for all others."""
    import trimesh

    percent_encoded = path.suffix.lower() in (".gltf", ".glb")

    class ContainedResolver(trimesh.resolvers.FilePathResolver):
        def __getitem__(self, name: str) -> bytes:
            file = contained_file(path, name.strip(), percent_encoded)
            if not file.is_file():
                raise FileNotFoundError(name)
            return file.read_bytes()

        def get(self, name: str) -> bytes:
            data = self[name]
            _check_image(data, f"{path}: the image {name[:80]!r}")
            return data

    return ContainedResolver(str(path))


def _check_gltf(path: Path) -> None:
    try:
        document, binary = gltf_content(path)
        for uri in uris(document):
            if not uri.startswith("data:"):
                contained_file(path, uri, percent_encoded=True)
        check_required_extensions(document, path)
        _check_size(path, document)
        for number, image in enumerate(document.get("images", [])):
            data = image_bytes(path, document, image, binary)
            if data is not None:
                _check_image(data, f"{path}: image {number}")
    except HirError:
        raise
    except Exception as error:  # any structure may be missing or of another type
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(f"{path} cannot be read as glTF ({reason}); export it again") from None


def _check_image(data: bytes, name: str) -> None:
    if data.startswith(IDENTIFIER):
        check_ktx2(data, name)
    else:
        open_image(data, name=name).close()


def gltf_content(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON document of a .gltf or .glb, and the binary chunk of a .glb. Raises `InputError` for other files."""
    try:
        text, chunks = split_document(path.read_bytes())
        document = parse_json(text)
    except (json.JSONDecodeError, struct.error, UnicodeDecodeError):
        document = None
    if not isinstance(document, dict):
        raise InputError(
            f"{path} is not a glTF file, or a damaged one; give it the ending of its own format, or export it again"
        )
    return document, chunks[8:]


def uris(document: dict[str, Any]) -> Iterator[str]:
    """The value of each `uri` in the document, those of extensions too."""
    pending: list[Any] = [document]
    while pending:
        value = pending.pop()
        if isinstance(value, dict):
            pending += value.values()
            if isinstance(value.get("uri"), str):
                yield value["uri"]
        elif isinstance(value, list):
            pending += value


def _check_size(path: Path, document: dict[str, Any]) -> None:
    accessors, meshes = document.get("accessors", []), document.get("meshes", [])
    nodes = document.get("nodes", [])
    if len(nodes) > MAX_NODES:
        raise InputError(f"{path} has {len(nodes)} nodes, more than {MAX_NODES}; join its meshes first")
    if any(accessor["count"] > MAX_ELEMENTS for accessor in accessors):
        raise InputError(f"{path} has an accessor of more than {MAX_ELEMENTS} elements; simplify it first")
    corners = [
        sum(accessors[p.get("indices", p["attributes"]["POSITION"])]["count"] for p in mesh["primitives"])
        for mesh in meshes
    ]
    placed = [node["mesh"] for node in nodes if node.get("mesh") is not None]
    if sum(len(meshes[mesh]["primitives"]) for mesh in placed) > MAX_NODES:
        raise InputError(f"{path} places more than {MAX_NODES} primitives; join its meshes first")
    if sum(corners[mesh] for mesh in placed) > MAX_ELEMENTS:
        raise InputError(f"{path} has more than {MAX_ELEMENTS} corners in all instances; simplify it first")


def image_bytes(path: Path, document: dict[str, Any], image: dict[str, Any], binary: bytes) -> bytes | None:
    """The content of an image; None where its file is missing."""
    if image.get("uri") is not None:
        return uri_bytes(path, image["uri"])
    view = document["bufferViews"][image["bufferView"]]
    uri = document["buffers"][view["buffer"]].get("uri")
    content = binary if uri is None else uri_bytes(path, uri)
    start = view.get("byteOffset", 0)
    return None if content is None else content[start : start + view["byteLength"]]


def uri_bytes(path: Path, uri: str) -> bytes | None:
    """What a URI of a glTF contains, a data URI or a file in its folder; None where that file is missing."""
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2])
        except binascii.Error as error:
            raise InputError(f"{path} has a data URI that is not base64 ({error}); export it again") from None
    file = contained_file(path, uri, percent_encoded=True)
    return file.read_bytes() if file.is_file() else None


def _check_obj(path: Path) -> None:
    content = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\\\n", b"")
    for line in content.split(b"\n"):
        if len(line) > _LONG_LINE and line.lstrip().startswith(b"f"):
            corners = line.split()[1:]
            if len(corners) > MAX_CORNERS:
                raise InputError(
                    f"{path} has a face of {len(corners)} corners; triangulate it, {MAX_CORNERS} can be read"
                )
            if max(map(len, corners), default=0) > MAX_INDEX_LENGTH:
                raise InputError(f"{path} has an index of too many digits; export it again")
        elif b"mtllib" in line:
            for name in library_names(line.partition(b"mtllib")[2].decode("utf-8", "replace").strip()):
                library = contained_file(path, name)
                if _is_file(library):
                    _check_mtl(path, library)


def _check_mtl(path: Path, library: Path) -> None:
    """Checks the textures of a material library, whose names are relative to the folder of the .obj `path`."""
    for material in read_library(library).values():
        for keyword, statement in material.items():
            if keyword.startswith(TEXTURES):
                image = contained_file(path, texture_map(statement.value).name)
                if _is_file(image):
                    open_image(image).close()


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is longer than the system allows
        return False
