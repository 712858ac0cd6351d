"""Serves one page to this machine, under an address that only the user's browser knows."""

from __future__ import annotations

import secrets
import socket
import threading
from collections.abc import Callable
from hmac import compare_digest
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final

from hir_exporters.errors import InputError

MAX_CONNECTIONS: Final = 16
"""Connections at a time; further ones are closed at once. A browser opens at most six."""

TIMEOUT_SECONDS: Final = 10.0
"""A client that sends or receives nothing for so long is disconnected."""


class PageServer(ThreadingHTTPServer):
    """A server on the loopback interface for one page; port 0 takes a free one.

    The page has a random address. Requests whose Host header is not this server's are refused: otherwise a web page
    could read it after it has its own name resolve to 127.0.0.1 (DNS rebinding).
    """

    daemon_threads = True

    def __init__(self, page: str, port: int = 0) -> None:
        self.body = page.encode()
        self.token = secrets.token_urlsafe(24)
        self._free = threading.BoundedSemaphore(MAX_CONNECTIONS)
        super().__init__(("127.0.0.1", port), PageHandler)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Accepted values of the Host header."""
        return tuple(f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost"))

    def process_request(self, request: socket.socket, client_address: tuple[str, int]) -> None:  # type: ignore[override]
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._free.release()
            raise

    def process_request_thread(self, request: socket.socket, client_address: tuple[str, int]) -> None:  # type: ignore[override]
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Prints nothing: a client that resets its connection is no fault of the user's."""


class PageHandler(BaseHTTPRequestHandler):
    """Answers GET for the page; 403 for another host, 404 for another path."""

    timeout = TIMEOUT_SECONDS
    server: PageServer

    def do_GET(self) -> None:
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0].lower() not in self.server.hosts:
            self._answer(403, b"")
        elif compare_digest(self.path.partition("?")[0].encode(), f"/{self.server.token}/".encode()):
            self._answer(200, self.server.body)
        else:
            self._answer(404, b"")

    def _answer(self, status: int, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Without the version of Python."""
        return "hir"

    def log_message(self, format: str, *arguments: object) -> None:
        """Logs nothing: requests come from the user's own browser."""


def serve(page: str, port: int = 0, on_ready: Callable[[str], None] | None = None) -> None:
    """Serves the page on the loopback interface until interrupted; port 0 takes a free one.

    `on_ready` receives the page's address. Raises `InputError` if the port cannot be used.
    """
    try:
        server = PageServer(page, port)
    except OSError as error:
        raise InputError(f"port {port} cannot be used ({error.strerror}); choose another with --port") from error
    with server:
        if on_ready is not None:
            on_ready(server.address)
        server.serve_forever()
