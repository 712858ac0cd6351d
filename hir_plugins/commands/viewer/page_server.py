"""Serves one page to this machine, under an address that only the user's browser knows."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hir_plugins.commands.loopback_server import LoopbackHandler, LoopbackServer, bound_server


class PageHandler(LoopbackHandler):
    """Answers GET for the page; 404 for another path."""

    server: PageServer

    def do_GET(self) -> None:  # noqa: N802 - the name that http.server calls
        if self.admitted():
            found = self.below_token == ""
            self.answer(200 if found else 404, self.server.body if found else b"")


class PageServer(LoopbackServer):
    """A server for one page."""

    handler = PageHandler

    def __init__(self, page: str, port: int = 0) -> None:
        self.body = page.encode()
        super().__init__(port)


def serve(page: str, port: int = 0, on_ready: Callable[[PageServer], None] | None = None) -> None:
    """Serves the page on the loopback interface until interrupted; port 0 takes a free one.

    `on_ready` receives the server with its addresses. Raises `InputError` if the port cannot be used.
    """
    with bound_server(partial(PageServer, page), port) as server:
        if on_ready is not None:
            on_ready(server)
        server.serve_forever()
