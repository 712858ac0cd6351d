"""A server that only this machine's user reaches: on the loopback interface, below an address that nobody can guess."""

from __future__ import annotations

import contextlib
import secrets
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from hmac import compare_digest
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar, Final, TypeVar

from hir_exporters.errors import InputError

MAX_CONNECTIONS: Final = 16
"""Connections at a time; further ones are closed at once. A browser opens at most six."""

TIMEOUT_SECONDS: Final = 10.0
"""A client that sends or receives nothing for so long is disconnected."""

COMMON_HEADERS: Final = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
SAME_ORIGIN: Final = {"Cross-Origin-Resource-Policy": "same-origin"}


class LoopbackServer(ThreadingHTTPServer):
    """A server on the loopback interface; port 0 takes a free one.

    Everything lies below a random address. Requests whose Host header is not this server's are refused: otherwise a web
    page could read it after it has its own name resolve to 127.0.0.1 (DNS rebinding).
    """

    daemon_threads = True
    handler: ClassVar[type[LoopbackHandler]]
    """What answers the requests; set by each server."""

    def __init__(self, port: int = 0) -> None:
        self.token = secrets.token_urlsafe(24)
        self._entrance = secrets.token_urlsafe(24)
        self._entrance_lock = threading.Lock()
        self._free = threading.BoundedSemaphore(MAX_CONNECTIONS)
        super().__init__(("127.0.0.1", port), self.handler)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"

    @property
    def entrance(self) -> str:
        """An address that leads to `address` once. A browser is started with this one: all users of a machine can read
        the arguments of its programs."""
        return f"http://127.0.0.1:{self.server_port}/{self._entrance}"

    def enter(self, path: str) -> bool:
        """Whether a request has the path of the entrance, for the first time."""
        with self._entrance_lock:
            found = bool(self._entrance) and compare_digest(path.encode(), f"/{self._entrance}".encode())
            if found:
                self._entrance = ""
        return found

    @property
    def hosts(self) -> tuple[str, ...]:
        """Accepted values of the Host header; browsers leave out port 80."""
        names = ("127.0.0.1", "localhost")
        return tuple(f"{name}:{self.server_port}" for name in names) + (names if self.server_port == 80 else ())

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


class LoopbackHandler(BaseHTTPRequestHandler):
    """What all requests have in common: the entrance, 403 for another host, 404 without the token."""

    timeout = TIMEOUT_SECONDS
    server: LoopbackServer

    def admitted(self) -> bool:
        """Whether the request may be answered; else it has been refused, or sent on from the entrance."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0].lower() not in self.server.hosts:
            self.answer(403, b"")
            return False
        if self.command == "GET" and self.server.enter(self.path):
            self.begin_answer(302, "text/html", {"Location": f"/{self.server.token}/", "Content-Length": "0"})
            return False
        token = self.path.partition("?")[0][: len(self.server.token) + 2]
        if not compare_digest(token.encode(), f"/{self.server.token}/".encode()):
            self.answer(404, b"")
            return False
        return True

    @property
    def below_token(self) -> str:
        """The path below the server's address, without what follows `?`, as the client wrote it."""
        return self.path.partition("?")[0][len(self.server.token) + 2 :]

    def answer(
        self,
        status: int,
        body: bytes,
        content_type: str = "text/html; charset=utf-8",
        headers: Mapping[str, str] = SAME_ORIGIN,
    ) -> None:
        """Sends a whole answer."""
        self.begin_answer(status, content_type, {"Content-Length": str(len(body)), **headers})
        self.wfile.write(body)

    def begin_answer(self, status: int, content_type: str, headers: Mapping[str, str]) -> None:
        """Sends the head of an answer, whose body the caller writes to `wfile`."""
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        for name, value in (COMMON_HEADERS | dict(headers)).items():
            self.send_header(name, value)
        self.end_headers()

    def version_string(self) -> str:
        """Without the version of Python."""
        return "hir"

    def log_message(self, format: str, *arguments: object) -> None:
        """Logs nothing: requests come from the user's own browser."""


Server = TypeVar("Server", bound=LoopbackServer)


@contextlib.contextmanager
def bound_server(create: Callable[[int], Server], port: int) -> Iterator[Server]:
    """The server on `port` until the block ends; `InputError` where the port cannot be used."""
    try:
        server = create(port)
    except OSError as error:
        raise InputError(f"port {port} cannot be used ({error.strerror}); choose another with --port") from error
    with server:
        yield server
