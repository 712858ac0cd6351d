"""The requests of the page of `hir ui`, and their answers."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, cast
from urllib.parse import parse_qs, quote, unquote

from hir_exporters.files.untrusted_json import parse_json

from hir_core.errors import HirError, InputError
from hir_core.files.contained_files import regular_file_within
from hir_core.files.json_documents import jsonable
from hir_plugins.commands.loopback_server import SAME_ORIGIN, LoopbackHandler, LoopbackServer
from hir_plugins.commands.ui.capture_entry import CaptureEntry
from hir_plugins.commands.ui.capture_library import CaptureLibrary

MAX_DOCUMENT_BYTES: Final = 8 << 20
"""Of the body of a request that is no file."""
MAX_ASSIGNMENTS: Final = 100
MAX_ASSIGNMENT: Final = 1000
DRAINED_BYTES: Final = 16 << 20
"""What is read of a refused body: a browser shows no answer to a request that it could not send."""
BLOCK_BYTES: Final = 1 << 20

PAGE_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
REPORT_POLICY: Final = "sandbox allow-scripts allow-downloads allow-popups"
"""The report runs scripts of its own: without an origin, so that they cannot send requests as the page does."""

PAGE_FILES: Final = {
    "": ("index.html", "text/html; charset=utf-8"),
    "ui.css": ("ui.css", "text/css; charset=utf-8"),
    "icon.svg": ("icon.svg", "image/svg+xml"),
} | {
    name: (name, "text/javascript; charset=utf-8")
    for name in ("ui.js", "requests.js", "dropped_files.js", "elements.js", "capture_view.js", "run_view.js")
}
"""The page and its parts by their address."""

JSON: Final = "application/json; charset=utf-8"
DOWNLOAD: Final = "application/octet-stream"


class RefusedRequestError(HirError):
    """A request that the page does not send."""

    def __init__(self, status: HTTPStatus, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


@dataclass(frozen=True)
class PresetChoice:
    """An entry of the list of presets."""

    name: str
    summary: str
    default: bool
    needs_scan: bool
    """It keeps the mesh of a scan, which `hir delight` reads."""


class UiHandler(LoopbackHandler):
    """Refuses requests of other pages, and gives the rest to a route; errors are answered as one sentence."""

    server: UiServer

    def do_GET(self) -> None:  # noqa: N802 - the name that http.server calls
        self._route(self._get)

    def do_POST(self) -> None:  # noqa: N802
        self._route(self._post)

    def do_PUT(self) -> None:  # noqa: N802
        self._route(self._put)

    def _route(self, handle: Callable[[Sequence[str]], None]) -> None:
        if not self.admitted():
            return
        self._unread = 0
        try:
            if self.command != "GET":
                self._begin_body()
            handle([unquote(part) for part in self.below_token.split("/")])
        except RefusedRequestError as error:
            self._answer_error(error.status, str(error))
        except HirError as error:
            self._answer_error(HTTPStatus.BAD_REQUEST, str(error))
        except (ConnectionError, TimeoutError):
            raise
        except OSError as error:  # a full disk, a folder that was removed
            place = error.filename or self.server.library.folder
            sentence = f"{place} cannot be read or written: {error.strerror}; check its permissions and the free space"
            self._answer_error(HTTPStatus.INTERNAL_SERVER_ERROR, sentence)
        except Exception as error:
            self._answer_error(HTTPStatus.INTERNAL_SERVER_ERROR, f"this is a bug: {type(error).__name__}: {error}")

    def _begin_body(self) -> None:
        """Checks where a request comes from, and how long its body is."""
        origins = self.headers.get_all("Origin", [])
        if len(origins) != 1 or origins[0].lower() != f"http://{self.headers['Host'].lower()}":
            raise RefusedRequestError(HTTPStatus.FORBIDDEN, "the request comes from another page")
        lengths = self.headers.get_all("Content-Length", [])
        if len(lengths) != 1 or not lengths[0].isascii() or not lengths[0].isdigit() or len(lengths[0]) > 15:
            raise RefusedRequestError(HTTPStatus.LENGTH_REQUIRED, "the request does not say how long it is")
        self._unread = int(lengths[0])

    def _get(self, parts: Sequence[str]) -> None:
        match parts:
            case [name] if name in PAGE_FILES:
                file, content_type = PAGE_FILES[name]
                body = (files("hir_plugins.commands.ui") / "page" / file).read_bytes()
                self.answer(200, body, content_type, SAME_ORIGIN | {"Content-Security-Policy": PAGE_POLICY})
            case ["state"]:
                self._answer_json(self.server.state(parse_qs(self.path.partition("?")[2]).get("capture", [""])[0]))
            case ["captures", name, *rest]:
                self._get_file(self._entry(name), rest)
            case _:
                raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is no such page")

    def _get_file(self, entry: CaptureEntry, parts: Sequence[str]) -> None:
        match parts:
            case ["sheet.png"]:
                self._send_file(regular_file_within(entry.folder, entry.sheet), "image/png")
            case ["check.json"]:
                self._send_file(regular_file_within(entry.folder, entry.check_document), JSON)
            case ["previews", name] if name.endswith(".png"):
                self._send_file(entry.preview(name.removesuffix(".png")), "image/png")
            case ["report.html"]:
                run = entry.run_directory.path
                # without Cross-Origin-Resource-Policy: a page without origin is of no site
                headers = {"Content-Security-Policy": REPORT_POLICY}
                self._send_file(regular_file_within(run, run / "report.html"), "text/html; charset=utf-8", headers)
            case ["exports.zip"]:
                self._send_archive(entry)
            case ["exports", *names]:
                exported = entry.exported_files().get("/".join(names))
                if exported is None:
                    raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is no such file")
                file = regular_file_within(entry.run_directory.path, exported)
                self._send_file(file, DOWNLOAD, SAME_ORIGIN | _attachment(file.name))
            case _:
                raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is no such file")

    def _post(self, parts: Sequence[str]) -> None:
        library = self.server.library
        document = self._read_document()
        match parts:
            case ["captures"]:
                path = document.get("path")
                if not isinstance(path, str):
                    raise InputError("give the path of a folder")
                self._answer_json({"capture": library.add_path(path).id})
            case ["uploads"]:
                self._answer_json({"upload": library.begin_upload(document)})
            case ["uploads", name, "finish"]:
                self._answer_json({"capture": library.finish_upload(name).id})
            case ["uploads", name, "cancel"]:
                library.cancel_upload(name)
                self._answer_json({})
            case ["captures", name, "check"]:
                library.start_check(self._entry(name))
                self._answer_json({})
            case ["captures", name, "start"]:
                entry = self._entry(name)
                preset = self.server.preset(document.get("preset"))
                library.start_run(entry, preset.name, assignments(document), named_scan(document, preset))
                self._answer_json({})
            case ["captures", name, "stop"]:
                self._entry(name).stop()
                self._answer_json({})
            case ["captures", name, "remove"]:
                library.remove(self._entry(name))
                self._answer_json({})
            case _:
                raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is no such request")

    def _put(self, parts: Sequence[str]) -> None:
        match parts:
            case ["uploads", name, index] if index.isascii() and index.isdigit() and len(index) < 8:
                upload = self.server.library.upload(name)
                if upload is None:
                    raise RefusedRequestError(HTTPStatus.NOT_FOUND, "this upload has ended; choose the folder again")
                length = self._unread
                upload.receive(int(index), cast(Any, _CountedBody(self)), length)
                self._answer_json({})
            case _:
                raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is no such request")

    def _entry(self, name: str) -> CaptureEntry:
        entry = self.server.library.entry(name)
        if entry is None:
            raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is no such capture")
        return entry

    def _read_document(self) -> dict[str, Any]:
        """The JSON object of a request; an empty one where the request has no body."""
        if not self._unread:
            return {}
        if self.headers.get_content_type() != "application/json":
            raise RefusedRequestError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "the request is not JSON")
        if self._unread > MAX_DOCUMENT_BYTES:
            raise RefusedRequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the folder holds too many files")
        try:
            document = parse_json(self.read_body(self._unread))
        except (ValueError, RecursionError):
            raise InputError("the request is not JSON") from None
        if not isinstance(document, dict):
            raise InputError("the request is not a JSON object")
        return document

    def read_body(self, size: int) -> bytes:
        """The next bytes of the request's body."""
        block = self.rfile.read(min(size, self._unread))
        self._unread -= len(block)
        return block

    def _send_file(self, path: Path, content_type: str, headers: Mapping[str, str] = SAME_ORIGIN) -> None:
        """Sends a file block by block."""
        with open(path, "rb") as stream:
            size = path.stat().st_size
            self.begin_answer(200, content_type, {"Content-Length": str(size), "Cache-Control": "no-store", **headers})
            while size and (block := stream.read(min(BLOCK_BYTES, size))):
                self.wfile.write(block)
                size -= len(block)

    def _send_archive(self, entry: CaptureEntry) -> None:
        """All exported files as .zip, which is written while it is sent."""
        exported = entry.exported_files()
        if not exported:
            raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there are no files")
        contained = {n: regular_file_within(entry.run_directory.path, path) for n, path in exported.items()}
        self.begin_answer(200, "application/zip", SAME_ORIGIN | _attachment(f"{entry.id}.zip"))
        with zipfile.ZipFile(self.wfile, "w", zipfile.ZIP_STORED) as archive:
            for name, path in contained.items():
                archive.write(path, f"{entry.id}/{name}")

    def _answer_json(self, document: object) -> None:
        headers = SAME_ORIGIN | {"Cache-Control": "no-store"}
        self.answer(200, json.dumps(jsonable(document)).encode(), JSON, headers)

    def _answer_error(self, status: int, sentence: str) -> None:
        drained = 0
        while self._unread and drained < DRAINED_BYTES:
            block = self.read_body(BLOCK_BYTES)
            if not block:
                break
            drained += len(block)
        body = json.dumps({"error": sentence}).encode()
        self.answer(status, body, JSON, SAME_ORIGIN | {"Cache-Control": "no-store"})


class _CountedBody:
    """The body of a request as a stream that ends where the request does."""

    def __init__(self, handler: UiHandler) -> None:
        self._handler = handler

    def read(self, size: int) -> bytes:
        return self._handler.read_body(size)


class UiServer(LoopbackServer):
    """The page of a library of captures."""

    handler = UiHandler

    def __init__(self, library: CaptureLibrary, presets: Sequence[PresetChoice], port: int = 0) -> None:
        self.library = library
        self.presets = tuple(presets)
        super().__init__(port)

    def preset(self, name: object) -> PresetChoice:
        """The preset of that name."""
        for preset in self.presets:
            if preset.name == name:
                return preset
        raise InputError(f"there is no preset {str(name)[:40]!r}")

    def state(self, selected: str) -> dict[str, Any]:
        """What the page displays: all captures, and the selected one in detail."""
        entry = self.library.entry(selected)
        return {
            "folder": str(self.library.folder),
            "presets": [asdict(preset) for preset in self.presets],
            "captures": [entry.summary() for entry in self.library.entries],
            "selected": None if entry is None else entry.document(),
        }


def named_scan(document: Mapping[str, Any], preset: PresetChoice) -> str | None:
    """The scan of a request as the user named it; None for a preset that makes a mesh."""
    scan = document.get("scan", "")
    if not isinstance(scan, str) or len(scan) > MAX_ASSIGNMENT:
        raise InputError("the scan is not the name of a file")
    return scan if preset.needs_scan else None


def assignments(document: Mapping[str, Any]) -> list[str]:
    """The settings `KEY=VALUE` of a request."""
    lines = document.get("settings", [])
    if not isinstance(lines, list) or len(lines) > MAX_ASSIGNMENTS:
        raise InputError(f"give at most {MAX_ASSIGNMENTS} settings, one a line")
    for line in lines:
        if not isinstance(line, str) or len(line) > MAX_ASSIGNMENT or "=" not in line or not line.isprintable():
            raise InputError(f"{str(line)[:60]!r} is not a setting; write KEY=VALUE, such as geometry.iterations=200")
    return list(lines)


def _attachment(name: str) -> dict[str, str]:
    return {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(name, safe='')}"}
