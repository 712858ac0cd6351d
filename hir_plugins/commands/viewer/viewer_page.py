"""`hir view`: a page that shows an asset in three.js, whole in itself; nothing is asked of the network.

three.js lies unchanged in `page/three/` (MIT licence beside it, `tools/copy_three.py`).
"""

from __future__ import annotations

import base64
import gzip
import html
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.errors import InputError
from hir_exporters.formats import create_exporter
from hir_exporters.light.environment_map import resample_latlong
from hir_exporters.reading.file_verification import READERS, read_back
from hir_exporters.reading.written_asset import written_asset
from hir_exporters.scene_format import load_scene
from hir_exporters.textures.image_files import read_exr, read_hdr
from hir_exporters.textures.rgbe import encode_rgbe

from hir_core.capture.capture_store import read_cameras
from hir_core.files.file_names import file_stem

MODULES: Final[tuple[tuple[str, dict[str, str]], ...]] = (
    ("three.core.js", {}),
    ("three.module.js", {"./three.core.js": "three.core.js"}),
    ("BufferGeometryUtils.js", {"three": "three.module.js"}),
    ("SkeletonUtils.js", {"three": "three.module.js"}),
    (
        "GLTFLoader.js",
        {
            "three": "three.module.js",
            "../utils/BufferGeometryUtils.js": "BufferGeometryUtils.js",
            "../utils/SkeletonUtils.js": "SkeletonUtils.js",
        },
    ),
    ("HDRLoader.js", {"three": "three.module.js"}),
    ("OrbitControls.js", {"three": "three.module.js"}),
    (
        "viewer.js",
        {
            "three": "three.module.js",
            "GLTFLoader": "GLTFLoader.js",
            "HDRLoader": "HDRLoader.js",
            "OrbitControls": "OrbitControls.js",
        },
    ),
)
"""Each module with its imports, after what it imports."""

COMPRESSIONS: Final = (b"KHR_draco_mesh_compression", b"EXT_meshopt_compression")
"""Extensions of glTF whose decoders the page does not bring."""

LIGHT_ROWS: Final = 256
"""A larger light is reduced: three.js blurs it for reflections anyway."""


def view_page(source: Path, light: Path | None = None, photographs: bool = True) -> str:
    """The page for a run, a scene folder, or a file; `light` is a lat-long .hdr or .exr in the asset's axes.

    A .glb is shown as it is; other formats, and compressed ones, as independent readers read them back. Without
    `light`, the run's light or the .hdr beside the file. `photographs` puts a run's beside it. Raises `InputError`
    naming what cannot be shown.
    """
    title, glb, radiance = _shown(source)
    if light is not None:
        if light.suffix.lower() not in (".hdr", ".exr"):
            raise InputError(f"--light {light}: a light is a lat-long .hdr or .exr")
        radiance = read_exr(light)[..., :3] if light.suffix.lower() == ".exr" else read_hdr(light)
    room = files("hir_plugins.commands.viewer") / "page"
    parts = {name: _file(room, name) for name, _ in MODULES}
    parts["asset.glb"] = glb
    if radiance is not None:
        parts["light.hdr"] = _encoded_light(radiance)
    beside, pictures = _photographs(source) if photographs else ([], {})
    parts |= pictures
    order = {
        "title": title,
        "photographs": beside,
        "toward": _first_camera(source),
        "modules": [{"name": name, "imports": imports} for name, imports in MODULES],
    }
    licence = (room / "three" / "LICENSE").read_text(encoding="utf-8")
    fields = {
        "title": html.escape(title),
        "css": (room / "page.css").read_text(encoding="utf-8"),
        "boot": (room / "boot.js").read_text(encoding="utf-8"),
        "order": json.dumps(order).replace("<", "\\u003c"),
        "parts": f"<!-- three.js {three_version()}\n{licence}-->\n"
        + "\n".join(
            f'<script type="application/octet-stream" id="part {name}">{_packed(data)}</script>'
            for name, data in parts.items()
        ),
    }
    page = (room / "page.html").read_text(encoding="utf-8")
    for name, text in fields.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def three_version() -> str:
    """The release of three.js that is inlined."""
    return (files("hir_plugins.commands.viewer") / "page" / "three" / "VERSION").read_text(encoding="utf-8").strip()


def serve(page: str, port: int = 0, on_ready: Callable[[str], None] | None = None) -> None:
    """Shows the page at an address of this machine only, until interrupted."""
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

    body = page.encode()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            known = self.path.partition("?")[0] == "/"
            self.send_response(200 if known else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(body if known else b"")

        def log_message(self, *_: Any) -> None:
            """Says nothing."""

    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    except OSError as error:
        raise InputError(f"port {port} cannot be used ({error.strerror}); give another with --port") from error
    with server:
        if on_ready is not None:
            on_ready(f"http://127.0.0.1:{server.server_port}/")
        server.serve_forever()


def _shown(source: Path) -> tuple[str, bytes, np.ndarray | None]:
    """Title, .glb and light (lat-long in world axes) of what is to be shown."""
    if source.is_dir():
        folder = source if (source / "scene.json").is_file() else source / "scene"
        if not (folder / "scene.json").is_file():
            raise InputError(f"{source} holds no finished scene; give a run, a scene folder or a file such as a .glb")
        asset = load_scene(folder)
        return asset.name, *_as_glb(asset)
    if not source.is_file():
        raise InputError(f"{source} is not there; give a run, a scene folder or a file such as a .glb")
    beside = source.with_suffix(".hdr")
    radiance = read_hdr(beside) if beside.is_file() else None
    data = source.read_bytes() if source.suffix.lower() == ".glb" else None
    if data is not None and not any(name in data for name in COMPRESSIONS):
        return source.stem, data, radiance
    if source.suffix.lower() not in READERS:
        raise InputError(f"{source} cannot be shown; known are runs, scene folders and {', '.join(READERS)}")
    back = written_asset(read_back(source, foreign=True))
    environment = None if radiance is None else AssetEnvironment(radiance)
    return source.stem, *_as_glb(Asset(back.mesh, back.material, environment, name=source.stem))


def _first_camera(source: Path) -> list[float] | None:
    """Where a run's first photograph was taken from, seen from the asset's middle (3,); None for all else."""
    if not (source / "capture" / "cameras.json").is_file() or not (source / "scene" / "scene.json").is_file():
        return None
    cameras = read_cameras(source / "capture" / "cameras.json")
    positions = load_scene(source / "scene").mesh.positions
    toward = [c.center - (positions.min(axis=0) + positions.max(axis=0)) / 2 for c in cameras.values()]
    return [float(x) for x in toward[0]] if toward else None


def _photographs(source: Path) -> tuple[list[dict[str, Any]], dict[str, bytes]]:
    """The photographs that a run's report keeps, over black and without distortion: their cameras, and their files.

    A camera is given as three.js wants it, looking along -z with y up, its matrix column by column.
    """
    if not (source / "capture" / "cameras.json").is_file() or not (source / "report").is_dir():
        return [], {}
    found: list[dict[str, Any]] = []
    pictures = {}
    for name, camera in read_cameras(source / "capture" / "cameras.json").items():
        file = source / "report" / f"{file_stem(name)}_true.png"
        if not file.is_file():
            continue
        part = f"photograph {len(found)}"
        pictures[part] = file.read_bytes()
        camera_to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
        focal, center = camera.intrinsics[1, 1], camera.intrinsics[:2, 2]
        found.append(
            {
                "name": name,
                "part": part,
                "width": camera.width,
                "height": camera.height,
                "fovYDeg": float(np.degrees(2 * np.arctan(camera.height / (2 * focal)))),
                "offset": [camera.width / 2 - float(center[0]), camera.height / 2 - float(center[1])],
                "columns": camera_to_world.T.reshape(-1).tolist(),
            }
        )
    return found, pictures


def _as_glb(asset: Asset) -> tuple[bytes, np.ndarray | None]:
    from hir_exporters.light.environment_map import world_radiance

    radiance = None if asset.environment is None else world_radiance(asset)[0]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "asset.glb"
        create_exporter("glb").write(replace(asset, environment=None), file)
        return file.read_bytes(), radiance


def _encoded_light(radiance: np.ndarray) -> bytes:
    if radiance.shape[0] > LIGHT_ROWS:
        radiance = resample_latlong(radiance, LIGHT_ROWS, 2 * LIGHT_ROWS)
    return encode_rgbe(np.asarray(radiance, np.float32))


def _file(room: Any, name: str) -> bytes:
    return bytes((room / (name if name == "viewer.js" else f"three/{name}")).read_bytes())


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode("ascii")
