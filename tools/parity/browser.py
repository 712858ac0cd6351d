"""Opens a page with an engine in a headless Chromium and returns the pictures that it renders.

A local server serves `/shots.json`, the files in `served`, and npm packages under `/modules/`. The page posts each
picture as PNG to `/picture/N`, or an error message to `/failed`.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
MODULES = (HERE.parent / "node_modules", HERE / "node_modules")
TYPES = {
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".json": "application/json",
    ".html": "text/html",
    ".wasm": "application/wasm",
}


def chromium_command() -> list[str] | None:
    """The command of a headless Chromium with software rendering, or None if it is not installed."""
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next((found for found in map(shutil.which, names) if found), None)
    if browser is None:
        return None
    return [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]


def module_folder(name: str) -> Path | None:
    """The folder of an npm package, or None if it is not installed."""
    return next((folder / name for folder in MODULES if (folder / name).is_dir()), None)


def module_version(name: str) -> str:
    """The version of an installed npm package."""
    folder = module_folder(name)
    assert folder is not None, name
    return str(json.loads((folder / "package.json").read_text(encoding="utf-8"))["version"])


def pictures_in_browser(
    chromium: Sequence[str],
    page: Path,
    shots: Sequence[Mapping[str, Any]],
    served: Mapping[str, bytes],
    seconds: float = 300,
) -> list[NDArray[np.float32]]:
    """sRGB pictures (H, W, 4), unassociated alpha, of each shot. Raises `RuntimeError` where the page fails."""
    bodies = {"/": page.read_bytes(), "/shots.json": json.dumps(list(shots)).encode(), **served}
    answers: dict[str, bytes] = {}
    finished = threading.Event()
    wanted = {f"/picture/{i}" for i in range(len(shots))}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            body = bodies[path] if path in bodies else _module_file(path)
            self.send_response(404 if body is None else 200)
            self.send_header("Content-Type", TYPES.get(Path(path).suffix or ".html", "application/octet-stream"))
            self.end_headers()
            self.wfile.write(body or b"")

        def do_POST(self) -> None:
            answers[self.path] = self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(204)
            self.end_headers()
            if "/failed" in answers or wanted <= set(answers):
                finished.set()

        def log_message(self, *_: object) -> None:
            """Suppresses the log."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        address = f"http://127.0.0.1:{server.server_port}/"
        arguments = [*chromium, f"--user-data-dir={profile}", address]
        process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            completed = finished.wait(seconds)
        finally:
            process.terminate()
            process.wait(20)
            server.shutdown()
            server.server_close()
    if "/failed" in answers:
        raise RuntimeError(f"{page.name}: {answers['/failed'].decode(errors='replace')}")
    if not completed:
        raise RuntimeError(f"{page.name} gave {len(answers)} of {len(shots)} pictures within {seconds:.0f} s")
    return [decoded_picture(answers[f"/picture/{i}"]) for i in range(len(shots))]


def decoded_picture(data: bytes) -> NDArray[np.float32]:
    """(H, W, 4) in [0, 1] of the bytes of a PNG."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGBA"), np.float32) / np.float32(255)


def _module_file(path: str) -> bytes | None:
    if not path.startswith("/modules/"):
        return None
    for folder in MODULES:
        file = (folder / path.removeprefix("/modules/")).resolve()
        if file.is_relative_to(folder.resolve()) and file.is_file():
            return file.read_bytes()
    return None
