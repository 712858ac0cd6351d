"""The server of `hir ui` answers the user's own page, within its folder, and nobody else."""

from __future__ import annotations

import http.client
import io
import json
import shutil
import time
import zipfile
from pathlib import Path
from typing import Any

import pytest

from hir_core.pipeline import Run
from hir_plugins.commands.ui import ui_server
from hir_plugins.commands.ui.ui_server import MAX_DOCUMENT_BYTES, PAGE_FILES, UiServer

Answer = tuple[int, http.client.HTTPMessage, bytes]


def ask(server: UiServer, method: str, path: str, body: bytes | None = None, **headers: str) -> Answer:
    """The answer to a request as the page sends it; `headers` replace those of the page, an empty one leaves it out."""
    host = f"127.0.0.1:{server.server_port}"
    sent = {"Host": host, "Content_Type": "application/json"}
    if method != "GET":
        sent |= {"Origin": f"http://{host}", "Content_Length": str(len(body or b""))}
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    connection.putrequest(method, f"/{server.token}/{path}", skip_host=True, skip_accept_encoding=True)
    for name, value in (sent | headers).items():
        if value:
            connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    if body:
        connection.send(body)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, answer.headers, content


def post(server: UiServer, path: str, document: Any = None, **headers: str) -> tuple[int, Any]:
    body = b"" if document is None else json.dumps(document).encode()
    status, _, content = ask(server, "POST", path, body, **headers)
    return status, json.loads(content or b"{}")


def test_the_page_runs_only_its_own_scripts(server: UiServer) -> None:
    for name in PAGE_FILES:
        status, headers, body = ask(server, "GET", name)
        assert status == 200 and body
        policy = headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self';") and "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy and "form-action 'none'" in policy
        assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"
    text = ask(server, "GET", "")[2].decode()
    assert "<script>" not in text and "style=" not in text and " on" not in text.split("<body>")[1].split(">")[0]


def test_every_file_of_the_page_is_served_and_nothing_else(server: UiServer) -> None:
    folder = Path(ui_server.__file__).parent / "page"
    assert {path.name for path in folder.iterdir()} == {file for file, _ in PAGE_FILES.values()}
    for path in ("../command.py", "..%2fcommand.py", "ui.js/", "/ui.js", "page/ui.js", "captures", "state/x", "%00"):
        assert ask(server, "GET", path)[0] == 404, path


def test_requests_of_other_pages_are_refused(server: UiServer) -> None:
    own = f"http://127.0.0.1:{server.server_port}"
    for origin in ("", "null", "http://evil.example", "http://127.0.0.1:1", f"{own}.evil.example", own + "/"):
        for method, path in (("POST", "captures"), ("PUT", "uploads/1/0")):
            status, _, content = ask(server, method, path, b'{"path": "/"}', Origin=origin)
            assert status == 403 and b"another page" in content
    assert ask(server, "GET", "state", Host="evil.example")[0] == 403
    assert ask(server, "POST", "captures", b"{}", Host="evil.example", Origin="http://evil.example")[0] == 403
    assert server.library.entries == []


def test_bodies_have_a_length_a_type_and_a_limit(server: UiServer) -> None:
    for length in ("", "-1", "+5", "1e3", "9" * 16, "５"):
        headers = {"Content_Length": length.encode().decode("latin-1")}
        assert ask(server, "POST", "captures", None, **headers)[0] == 411, length
    assert post(server, "captures", {"path": "/"}, Content_Type="text/plain")[0] == 415
    status, _, content = ask(server, "POST", "uploads", bytes(MAX_DOCUMENT_BYTES + 1))
    assert status == 413 and b"too many files" in content, "a large body is read, so that the answer arrives"
    for body in (b"[", b"[]", b"\xff", b"[" * 10_000, b'"x"'):
        assert ask(server, "POST", "captures", body)[0] == 400
    assert post(server, "captures", {"path": 3}) == (400, {"error": "give the path of a folder"})


def test_what_does_not_exist_is_not_found(server: UiServer) -> None:
    for path in ("captures/none/check", "captures/none/start", "captures/../start", "captures", "x"):
        status, answer = post(server, path, {})
        assert (status, "error" in answer) == (400 if path == "captures" else 404, True)
    for path in ("uploads/none/0", "uploads/none/-1", "uploads/none/x", "uploads/none/99999999", "uploads", "state"):
        assert ask(server, "PUT", path, b"x")[0] == 404
    assert ask(server, "DELETE", "state")[0] == 501


def test_files_are_streamed_into_the_folder(server: UiServer) -> None:
    content = bytes(range(256)) * 20_000
    files = [{"path": "train/Möwe 1.png", "size": len(content)}, {"path": "empty.txt", "size": 0}]
    status, answer = post(server, "uploads", {"name": "my <b>capture</b>", "files": files})
    assert status == 200
    upload = answer["upload"]
    assert ask(server, "PUT", f"uploads/{upload}/0", content[:-1])[0] == 400
    assert ask(server, "PUT", f"uploads/{upload}/2", b"")[0] == 400
    assert post(server, f"uploads/{upload}/finish")[0] == 400
    assert [ask(server, "PUT", f"uploads/{upload}/{n}", body)[0] for n, body in enumerate((content, b""))] == [200, 200]
    status, answer = post(server, f"uploads/{upload}/finish")
    assert (status, answer) == (200, {"capture": "my--b-capture--b"})
    stored = server.library.folder / answer["capture"] / "photographs" / answer["capture"]
    assert (stored / "train" / "Möwe 1.png").read_bytes() == content
    assert ask(server, "PUT", f"uploads/{upload}/0", content)[0] == 404


def test_a_client_that_leaves_leaves_no_half_file(server: UiServer) -> None:
    upload = post(server, "uploads", {"name": "a", "files": [{"path": "a.png", "size": 1000}]})[1]["upload"]
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    origin = {"Origin": f"http://127.0.0.1:{server.server_port}", "Content-Length": "1000"}
    connection.request("PUT", f"/{server.token}/uploads/{upload}/0", b"x" * 10, origin)
    connection.close()
    arriving = server.library.upload(upload)
    assert arriving is not None
    # the server may not have begun with the request, or be waiting for its end: the file is refused until then
    whole = f"uploads/{upload}/0", b"x" * 1000
    deadline = time.monotonic() + 20
    while (status := ask(server, "PUT", *whole)[0]) == 400 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert status == 200
    assert [len(file.read_bytes()) for file in arriving.folder.rglob("*") if file.is_file()] == [1000]


def test_settings_are_lines_and_presets_are_known(server: UiServer, tiny_capture: Path) -> None:
    capture = server.library.add_path(str(tiny_capture)).id
    for document in (
        {},
        {"preset": "delight"},
        {"preset": "delight", "scan": "nowhere.glb"},
        {"preset": "delight", "scan": "../run.json"},
        {"preset": "delight", "scan": ["a.glb"]},
        {"preset": "../x"},
        {"preset": ["fast"]},
        {"preset": "fast", "settings": "a=1"},
        {"preset": "fast", "settings": [1]},
        {"preset": "fast", "settings": ["--help"]},
        {"preset": "fast", "settings": ["a=1\n"]},
        {"preset": "fast", "settings": ["a=" + "1" * 1000]},
        {"preset": "fast", "settings": ["a=1"] * 101},
    ):
        status, answer = post(server, f"captures/{capture}/start", document)
        assert status == 400 and answer["error"]
    names = [choice.name for choice in server.presets]
    assert names[0] == "fast" and {"best", "paper"} <= set(names)
    assert [choice.name for choice in server.presets if choice.needs_scan] == ["delight"] == names[-1:]
    assert all(choice.summary and "`" not in choice.summary for choice in server.presets)


@pytest.fixture
def with_run(server: UiServer, finished: Run, tiny_capture: Path) -> UiServer:
    """A server whose library has one finished run."""
    entry = server.library.add_path(str(tiny_capture))
    assert entry.check is not None
    entry.check._process.wait(60)
    shutil.copytree(finished.path, entry.run_directory.path)
    return server


def test_a_finished_run_is_displayed_and_downloaded(with_run: UiServer, finished: Run) -> None:
    state = json.loads(ask(with_run, "GET", "state?capture=tiny")[2])
    selected = state["selected"]
    assert state["captures"] == [{"id": "tiny", "name": "tiny", "state": "finished"}]
    assert [stage["finished"] for stage in selected["run"]["stages"]] == [True] * 6
    exported = {p.relative_to(finished.path / "exports").as_posix(): p for p in (finished.path / "exports").iterdir()}
    assert {f["path"]: f["bytes"] for f in selected["run"]["files"]} == {
        name: path.stat().st_size for name, path in exported.items()
    }
    for name, path in exported.items():
        status, headers, content = ask(with_run, "GET", f"captures/tiny/exports/{name}")
        assert status == 200 and content == path.read_bytes()
        assert headers["Content-Disposition"] == f"attachment; filename*=UTF-8''{name}"
    with zipfile.ZipFile(io.BytesIO(ask(with_run, "GET", "captures/tiny/exports.zip")[2])) as archive:
        assert archive.testzip() is None
        assert {n: archive.read(n) for n in archive.namelist()} == {
            f"tiny/{name}": path.read_bytes() for name, path in exported.items()
        }
    check = json.loads(ask(with_run, "GET", "captures/tiny/check.json")[2])
    assert len(check["views"]) == 10
    assert ask(with_run, "GET", "captures/tiny/sheet.png")[2].startswith(b"\x89PNG")


def test_the_report_has_no_access_to_the_page(with_run: UiServer, finished: Run) -> None:
    status, headers, content = ask(with_run, "GET", "captures/tiny/report.html")
    assert status == 200 and content == (finished.path / "report.html").read_bytes()
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("sandbox ") and "allow-same-origin" not in policy


def test_nothing_outside_of_the_exports_is_sent(with_run: UiServer, tmp_path: Path) -> None:
    entry = with_run.library.entry("tiny")
    assert entry is not None
    exports = entry.run_directory.exports
    (tmp_path / "secret.txt").write_text("secret")
    (exports / "link.txt").symlink_to(tmp_path / "secret.txt")
    (exports / "linked").symlink_to(tmp_path)
    (exports / ".hidden").write_text("secret")
    for name in (
        *("../run.json", "..%2frun.json", "%2e%2e/run.json", "../../capture.json", "link.txt", "linked/secret.txt"),
        *(".hidden", "", "/etc/passwd", "%2fetc%2fpasswd", "none.glb", "%00", "..\\run.json"),
    ):
        assert ask(with_run, "GET", f"captures/tiny/exports/{name}")[0] == 404, name
    with zipfile.ZipFile(io.BytesIO(ask(with_run, "GET", "captures/tiny/exports.zip")[2])) as archive:
        assert not any("secret" in name or "link" in name or "hidden" in name for name in archive.namelist())
    for name in ("none.png", "..%2f..%2frun.json", "geometry", "geometry.png", "..png"):
        assert ask(with_run, "GET", f"captures/tiny/previews/{name}")[0] in (400, 404)
    (entry.run_directory.path / "report.html").unlink()
    (entry.run_directory.path / "report.html").symlink_to(tmp_path / "secret.txt")
    status, _, content = ask(with_run, "GET", "captures/tiny/report.html")
    assert status == 400 and b"secret" not in content.replace(b"secret.txt", b"")


def test_one_reconstruction_at_a_time(with_run: UiServer, tiny_capture: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_capture, tmp_path / "second")
    second = with_run.library.add_path(str(tmp_path / "second"))
    assert second.check is not None
    second.check._process.wait(60)
    assert post(with_run, "captures/tiny/start", {"preset": "fast"}) == (200, {})
    status, answer = post(with_run, "captures/second/start", {"preset": "fast"})
    assert status == 400 and "tiny is being reconstructed" in answer["error"]
    assert post(with_run, "captures/tiny/check")[0] == 400
    assert post(with_run, "captures/tiny/stop") == (200, {})
    entry = with_run.library.entry("tiny")
    assert entry is not None and entry.run is not None
    entry.run._process.wait(20)
    assert entry.state == "stopped"
