"""Opens an exported .glb in three.js in a headless Chromium and brings back the picture."""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from hir_exporters.images import read_ldr

from hir_core.capture import Camera

HERE = Path(__file__).parent
THREE = HERE.parents[1] / "tools" / "node_modules" / "three"
TYPES = {".js": "text/javascript", ".json": "application/json", ".html": "text/html"}


def shot_document(camera: Camera) -> dict[str, object]:
    """A camera as three.js and Blender want it: they look along -z with y up; matrices column by column."""
    camera_to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
    return {
        "width": camera.width,
        "height": camera.height,
        "fov_y_deg": float(np.degrees(2 * np.arctan(camera.height / (2 * camera.intrinsics[1, 1])))),
        "camera_to_world_columns": camera_to_world.T.reshape(-1).tolist(),
    }


def picture_in_three(
    chromium: list[str], glb: Path, hdr: Path, camera: Camera, turn_y: float, seconds: float = 300
) -> np.ndarray:
    """sRGB picture (H, W, 4), unassociated, of the asset as three.js shows it."""
    shot = shot_document(camera) | {"turn_y": turn_y}
    served = {
        "/": (HERE / "page.html").read_bytes(),
        "/shot.json": json.dumps(shot).encode(),
        "/asset.glb": glb.read_bytes(),
        "/asset.hdr": hdr.read_bytes(),
    }
    answers: dict[str, bytes] = {}
    answered = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            body = served.get(path)
            if body is None and path.startswith("/three/"):
                file = (THREE / path.removeprefix("/three/")).resolve()
                body = file.read_bytes() if file.is_relative_to(THREE.resolve()) and file.is_file() else None
            self.send_response(404 if body is None else 200)
            self.send_header("Content-Type", TYPES.get(Path(path).suffix or ".html", "application/octet-stream"))
            self.end_headers()
            self.wfile.write(body or b"")

        def do_POST(self) -> None:
            answers[self.path] = self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(204)
            self.end_headers()
            answered.set()

        def log_message(self, *_: object) -> None:
            """Says nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        address = f"http://127.0.0.1:{server.server_port}/"
        words = [*chromium, f"--user-data-dir={profile}", address]
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            came = answered.wait(seconds)
        finally:
            process.terminate()
            process.wait(20)
            server.shutdown()
            server.server_close()
    assert came, f"the page gave no picture within {seconds:.0f} s"
    assert "/picture" in answers, answers.get("/failed", b"").decode()
    picture = glb.with_suffix(".three.png")
    picture.write_bytes(answers["/picture"])
    return read_ldr(picture)
