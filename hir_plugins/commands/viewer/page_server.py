"""Serves one page to this machine."""

from __future__ import annotations

from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from hir_exporters.errors import InputError


def serve(page: str, port: int = 0, on_ready: Callable[[str], None] | None = None) -> None:
    """Serves the page on the loopback interface until interrupted; port 0 takes a free one.

    `on_ready` receives the page's address. Raises `InputError` if the port cannot be used.
    """
    body = page.encode()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = self.path.partition("?")[0] == "/"
            self.send_response(200 if found else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(body if found else b"")

        def log_message(self, format: str, *arguments: object) -> None:
            """Logs nothing: requests come from the user's own browser."""

    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    except OSError as error:
        raise InputError(f"port {port} cannot be used ({error.strerror}); choose another with --port") from error
    with server:
        if on_ready is not None:
            on_ready(f"http://127.0.0.1:{server.server_port}/")
        server.serve_forever()
