"""`hir view` serves its page to the user's browser: not to other web pages, not to idle clients, without noise."""

from __future__ import annotations

import http.client
import socket
import struct
import threading
from collections.abc import Iterator

import pytest

from hir_plugins.commands.loopback_server import MAX_CONNECTIONS
from hir_plugins.commands.viewer import page_server
from hir_plugins.commands.viewer.page_server import PageServer

PAGE = "<p>ä</p>"


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(PAGE) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def get(server: PageServer, path: str = "", host: str = "") -> tuple[int, str]:
    """Status and text of an answer; by default to a request as a browser sends it."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.putrequest("GET", path or f"/{server.token}/", skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{server.server_port}")
    connection.endheaders()
    answer = connection.getresponse()
    status, text = answer.status, answer.read().decode()
    connection.close()
    return status, text


def connect(server: PageServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.server_port), timeout=10)


def test_the_page_has_a_random_address(server: PageServer) -> None:
    assert get(server) == (200, PAGE)
    assert get(server, f"/{server.token}/?x=1")[0] == 200
    for path in ("/", "/index.html", f"/{server.token[:-1]}/", f"/{server.token}", f"/{server.token}/../", "/%C3%A4"):
        assert get(server, path) == (404, "")
    with PageServer(PAGE) as other:
        assert other.token != server.token and len(server.token) >= 32


def test_the_entrance_leads_to_the_page_once(server: PageServer) -> None:
    """A browser is started with it, and its arguments are public."""
    path = server.entrance.removeprefix(f"http://127.0.0.1:{server.server_port}")
    assert server.token not in server.entrance
    assert get(server, path, host="evil.example")[0] == 403
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.request("GET", path)
    answer = connection.getresponse()
    assert (answer.status, answer.headers["Location"]) == (302, f"/{server.token}/")
    connection.close()
    assert get(server, path) == (404, "") and get(server, "/") == (404, "")


def test_port_80_is_not_named_by_browsers(server: PageServer) -> None:
    assert server.hosts == (f"127.0.0.1:{server.server_port}", f"localhost:{server.server_port}")
    server.server_port = 80
    assert "127.0.0.1" in server.hosts and "localhost" in server.hosts


def test_another_host_gets_nothing(server: PageServer) -> None:
    """A web page whose name resolves to 127.0.0.1 sends its own name."""
    for host in ("evil.example", f"evil.example:{server.server_port}", "127.0.0.1", "127.0.0.1:1", "localhost.evil:80"):
        assert get(server, host=host) == (403, "")
    assert get(server, host=f"localhost:{server.server_port}") == (200, PAGE)


def test_a_request_without_or_with_two_hosts_gets_nothing(server: PageServer) -> None:
    own = f"Host: 127.0.0.1:{server.server_port}\r\n"
    for hosts in ("", own + "Host: evil.example\r\n"):
        with connect(server) as client:
            client.sendall(f"GET /{server.token}/ HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n".encode())
            answer = client.makefile("rb").read()
        assert b" 403 " in answer.splitlines()[0] and PAGE.encode() not in answer


def test_connections_are_limited(server: PageServer) -> None:
    idle = [connect(server) for _ in range(MAX_CONNECTIONS)]
    for client in idle:
        client.sendall(b"GET")  # begins a request and never ends it
    with connect(server) as one_more:
        try:
            one_more.sendall(b"GET / HTTP/1.0\r\n\r\n")
            assert one_more.recv(1) == b""
        except ConnectionError:
            pass  # closed before the request was written
    for client in idle:
        client.close()
    for _ in range(100):
        try:
            assert get(server) == (200, PAGE)
            return
        except (ConnectionError, http.client.HTTPException):
            continue  # their threads are still ending
    pytest.fail("the server does not serve after idle clients have left")


def test_an_idle_client_is_disconnected(monkeypatch: pytest.MonkeyPatch, server: PageServer) -> None:
    monkeypatch.setattr(page_server.PageHandler, "timeout", 0.2)
    with connect(server) as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost:")
        assert client.recv(1) == b""


def test_a_client_that_resets_is_silent(server: PageServer, capfd: pytest.CaptureFixture[str]) -> None:
    server.body = b"x" * (32 << 20)  # more than the system buffers, so that writing fails
    for _ in range(3):
        client = connect(server)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.sendall(f"GET /{server.token}/ HTTP/1.0\r\nHost: 127.0.0.1:{server.server_port}\r\n\r\n".encode())
        assert client.recv(10)
        client.close()  # a reset, because of SO_LINGER
    server.body = PAGE.encode()
    assert get(server) == (200, PAGE)
    for thread in threading.enumerate():
        if "process_request_thread" in thread.name:
            thread.join(5)
    assert capfd.readouterr() == ("", "")
