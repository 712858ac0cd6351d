"""Screenshots of a report for the documentation: `python tools/shoot_report.py RUN OUT.jpg [--theme dark]`.

The page is served to a headless Chromium from this machine, so that the frame with the asset shares its clock.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from parity.browser import chromium_command


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Prints nothing."""


def shoot(report: Path, picture: Path, width: int, height: int, theme: str = "light", scale: float = 1.0) -> None:
    """Writes a PNG of the page's first `height` pixels. Raises `RuntimeError` where there is no Chromium."""
    chromium = chromium_command()
    if chromium is None:
        raise RuntimeError("no Chromium on the path; install chromium")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(report.parent)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        arguments = [
            *chromium,
            f"--user-data-dir={profile}",
            "--hide-scrollbars",
            f"--window-size={width},{height}",
            f"--force-device-scale-factor={scale:g}",
            "--virtual-time-budget=256000",
            f"--screenshot={picture}",
            f"http://127.0.0.1:{server.server_port}/{report.name}#still&theme={theme}",
        ]
        subprocess.run(arguments, check=True, capture_output=True, timeout=180)
    server.shutdown()
    server.server_close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--theme", choices=("light", "dark"), default="light")
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=1150)
    parser.add_argument("--top", type=int, default=0, help="Number of pixels to remove at the top.")
    options = parser.parse_args()
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        shoot(options.run / "report.html", shot, options.width, options.height, options.theme)
        with Image.open(shot) as opened:
            cut = opened.convert("RGB").crop((0, options.top, options.width, options.height))
            cut.save(options.picture, quality=88)
    print(options.picture)


if __name__ == "__main__":
    main()
