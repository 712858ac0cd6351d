"""The folder of `hir ui`: what it holds, who uses it, what another session finds in it."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from hir_core.errors import InputError
from hir_core.run.run_directory import FORMAT, LAST_STAGE, VERSION
from hir_plugins.commands.ui.capture_entry import CaptureEntry
from hir_plugins.commands.ui.capture_library import MAX_UPLOADS, CaptureLibrary
from hir_plugins.commands.ui.hir_process import KEPT_LINES, HirProcess
from hir_plugins.commands.ui.scan_files import scan_file


@pytest.fixture
def library(tmp_path: Path) -> Iterator[CaptureLibrary]:
    with closing(CaptureLibrary(tmp_path / "library")) as opened:
        yield opened


def wait(entry: CaptureEntry, seconds: float = 60) -> str:
    """The state when nothing runs any more."""
    deadline = time.monotonic() + seconds
    while entry.is_busy and time.monotonic() < deadline:
        time.sleep(0.05)
    return entry.state


def send(library: CaptureLibrary, name: str, files: dict[str, bytes]) -> CaptureEntry:
    listed = [{"path": path, "size": len(content)} for path, content in files.items()]
    upload = library.begin_upload({"name": name, "files": listed})
    arriving = library.upload(upload)
    assert arriving is not None
    for index, content in enumerate(files.values()):
        arriving.receive(index, io.BytesIO(content), len(content))
    return library.finish_upload(upload)


def test_a_capture_is_added_while_others_are_checked(
    library: CaptureLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waits for the button; a start by the button says why it has to wait."""
    monkeypatch.setattr(CaptureEntry, "state", property(lambda entry: "checking" if entry.id in "ab" else "new"))
    started: list[str] = []
    monkeypatch.setattr(CaptureEntry, "start_check", lambda entry: started.append(entry.id))
    for name in "abc":
        (tmp_path / name).mkdir()
        library.add_path(str(tmp_path / name))
    assert started == ["a", "b"] and [entry.id for entry in library.entries] == ["a", "b", "c"]
    with pytest.raises(InputError, match="a is being checked; check c when it is done"):
        library.start_check(library.entries[2])


def test_one_of_two_starts_at_a_time_wins(
    library: CaptureLibrary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two tabs of a browser may start two captures in the same moment."""
    running: set[str] = set()

    def start(entry: CaptureEntry, *_: object) -> None:
        time.sleep(0.2)
        running.add(entry.id)

    monkeypatch.setattr(CaptureEntry, "start_check", lambda entry: None)
    monkeypatch.setattr(CaptureEntry, "start_run", start)
    monkeypatch.setattr(CaptureEntry, "state", property(lambda entry: "running" if entry.id in running else "new"))
    for name in "ab":
        (tmp_path / name).mkdir()
    entries = [library.add_path(str(tmp_path / name)) for name in "ab"]
    barrier = threading.Barrier(2)
    refused: list[str] = []

    def press(entry: CaptureEntry) -> None:
        barrier.wait()
        try:
            library.start_run(entry, "fast", [])
        except InputError as error:
            refused.append(str(error))

    threads = [threading.Thread(target=press, args=(entry,)) for entry in entries]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(running) == len(refused) == 1 and "is being reconstructed" in refused[0]


def test_a_damaged_record_hides_one_capture(tmp_path: Path) -> None:
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        library.begin_upload({"name": "x", "files": [{"path": "a.png", "size": 1}]})
        send(library, "good", {"a.png": b"x"})
        (library.folder / "bad").mkdir()
        record = json.loads((library.folder / "good" / "capture.json").read_text())
        (library.folder / "bad" / "capture.json").write_text(json.dumps({**record, "name": "bad", "source": "/a\0b"}))
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        assert [entry.id for entry in library.entries] == ["good"]


def test_a_stored_capture_names_no_plugins(tmp_path: Path) -> None:
    """Their code would be executed by a press of Start, in a folder that somebody else may have sent."""
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        entry = send(library, "sent", {"a.png": b"x"})
        record = json.loads((entry.folder / "capture.json").read_text())
        record["settings"] = ['plugins=["evil.py"]', ' plugins = ["evil.py"]', "geometry.iterations=5"]
        (entry.folder / "capture.json").write_text(json.dumps(record))
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        assert library.entries[0].settings == ("geometry.iterations=5",)


@pytest.mark.parametrize("name", ["reconstruct.txt", "run", "check"])
def test_a_link_in_a_stored_capture_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "outside").write_text("precious")
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        folder = send(library, "sent", {"a.png": b"x"}).folder
    shutil.rmtree(folder / name, ignore_errors=True)
    (folder / name).symlink_to(tmp_path / "outside")
    with pytest.raises(InputError, match="is a symbolic link"):
        CaptureLibrary(tmp_path / "library")
    (folder / name).unlink()
    CaptureLibrary(tmp_path / "library").close()
    assert (tmp_path / "outside").read_text() == "precious"


def test_a_path_is_checked_where_it_is_and_found_by_the_next_session(tiny_capture: Path, tmp_path: Path) -> None:
    before = sorted(tiny_capture.rglob("*"))
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        entry = library.add_path(f" {tiny_capture} ")
        assert (entry.id, entry.source) == ("tiny", tiny_capture) and entry.state == "checking"
        assert wait(entry) == "checked"
        assert library.add_path(str(tiny_capture)) is entry, "one capture is one entry"
        assert wait(entry) == "checked"
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        [entry] = library.entries
        assert (entry.name, entry.source, entry.state) == ("tiny", tiny_capture, "checked")
    assert sorted(tiny_capture.rglob("*")) == before, "nothing is written into the capture"


def test_what_is_uploaded_is_checked_and_its_failure_has_a_sentence(library: CaptureLibrary) -> None:
    first, second = (send(library, "../My photographs!", {"notes.txt": b"no pictures"}) for _ in range(2))
    assert (first.id, second.id) == ("My-photographs", "My-photographs-2")
    assert first.source == library.folder / "My-photographs" / "photographs" / "My-photographs"
    assert (first.source / "notes.txt").read_bytes() == b"no pictures"
    assert wait(first) == wait(second) == "check_failed"
    sentence = first.document()["sentence"]
    assert "is no capture that an installed reader knows" in sentence and not sentence.startswith("hir:")


@pytest.mark.parametrize("path", ["", "  ", "relative/folder", "/does/not/exist", "~nobody-of-this-name/x", "/a\0b"])
def test_a_path_that_is_none_is_refused(path: str, library: CaptureLibrary) -> None:
    with pytest.raises(InputError):
        library.add_path(path)
    assert library.entries == []


def test_the_folder_itself_is_no_capture(library: CaptureLibrary) -> None:
    for path in (library.folder, library.folder.parent):
        with pytest.raises(InputError, match="holds the captures of this page"):
            library.add_path(str(path))


def test_one_session_at_a_time(library: CaptureLibrary, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="another hir ui uses"):
        CaptureLibrary(library.folder)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        CaptureLibrary(tmp_path / "file")


def test_unfinished_uploads_are_limited_and_removed(tmp_path: Path) -> None:
    listed = {"name": "a", "files": [{"path": "a.png", "size": 1}]}
    library = CaptureLibrary(tmp_path)
    names = [library.begin_upload(listed) for _ in range(MAX_UPLOADS)]
    with pytest.raises(InputError, match="are being copied"):
        library.begin_upload(listed)
    library.cancel_upload(names[0])
    library.begin_upload(listed)
    with pytest.raises(InputError, match="has ended"):
        library.finish_upload(names[0])
    with pytest.raises(InputError, match="not arrived"):
        library.finish_upload(names[1])
    library.close()
    assert [p.name for p in tmp_path.iterdir() if p.name != ".lock"] == []
    (tmp_path / ".upload-left").mkdir()
    (tmp_path / "a stranger's").mkdir()
    with closing(CaptureLibrary(tmp_path)) as library:
        assert library.entries == [] and not (tmp_path / ".upload-left").exists()
    assert (tmp_path / "a stranger's").is_dir()


def test_a_link_is_no_entry(library: CaptureLibrary, tmp_path: Path, tiny_capture: Path) -> None:
    wait(library.add_path(str(tiny_capture)))
    folder = library.folder
    library.close()
    os.rename(folder / "tiny", tmp_path / "elsewhere")
    (folder / "tiny").symlink_to(tmp_path / "elsewhere")
    with closing(CaptureLibrary(folder)) as again:
        assert again.entries == []


def test_what_is_removed_is_gone_and_a_folder_elsewhere_stays(
    library: CaptureLibrary, tiny_capture: Path, tmp_path: Path
) -> None:
    before = {path: path.read_bytes() for path in tiny_capture.rglob("*") if path.is_file()}
    elsewhere, own = library.add_path(str(tiny_capture)), send(library, "mine", {"notes.txt": b"no pictures"})
    with pytest.raises(InputError, match="stop it first"):
        library.remove(elsewhere)
    for entry in (elsewhere, own):
        wait(entry)
        library.remove(entry)
    assert library.entries == [] and [p.name for p in library.folder.iterdir()] == [".lock"]
    assert {path: path.read_bytes() for path in tiny_capture.rglob("*") if path.is_file()} == before
    assert library.add_path(str(tiny_capture)).id == elsewhere.id, "its name is free again"


def test_what_could_not_be_deleted_is_deleted_by_the_next_session(tmp_path: Path) -> None:
    (tmp_path / ".removed-0" / "run").mkdir(parents=True)
    with closing(CaptureLibrary(tmp_path)) as library:
        assert library.entries == [] and not (tmp_path / ".removed-0").exists()


def test_meshes_among_the_photographs_are_offered(library: CaptureLibrary, tmp_path: Path) -> None:
    files = {"a.txt": b"-", "scan/cow.OBJ": b"v 0 0 0", "scan.glb": b"-", "a/b/c/d/e.ply": b"-"}
    entry = send(library, "cow", files)
    wait(entry)
    assert entry.document()["scans"] == ("scan.glb", "scan/cow.OBJ")
    assert scan_file("scan/cow.OBJ", entry.source) == entry.source / "scan" / "cow.OBJ"
    assert scan_file(f" {entry.source / 'scan.glb'} ", tmp_path) == entry.source / "scan.glb"
    (entry.source / "link.obj").symlink_to(library.folder / ".lock")
    outside = ("../../capture.json", "link.obj", str(tmp_path), "~nobody-here/x")
    for name in ("", " ", "nowhere.obj", "scan", "a\0b", *outside):
        with pytest.raises(InputError):
            scan_file(name, entry.source)


def test_a_run_with_a_scan_is_delight(
    library: CaptureLibrary, tiny_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is started is the command line that a user would type; the next session knows the scan."""
    entry = library.add_path(str(tiny_capture))
    wait(entry)
    scan = tmp_path / "cow.obj"
    scan.write_text("v 0 0 0\n")
    started: list[list[str]] = []

    def start(arguments: list[str], output: Path) -> HirProcess:
        started.append(arguments)
        return HirProcess(["--version"], output)

    monkeypatch.setattr("hir_plugins.commands.ui.capture_entry.HirProcess", start)
    library.start_run(entry, "delight", ["atlas.texture_size=64"], str(scan))
    run = str(entry.run_directory.path)
    assert started[0][:6] == ["delight", str(scan), str(tiny_capture), "-o", run, "-q"]
    assert started[0][-1] == "--set=atlas.texture_size=64" and "--resume" not in started[0]
    wait(entry)
    folder = library.folder
    library.close()
    with closing(CaptureLibrary(folder)) as again:
        assert [(e.preset, e.scan) for e in again.entries] == [("delight", str(scan))]


def test_a_run_that_cannot_start_says_why_and_another_may_follow(library: CaptureLibrary, tiny_capture: Path) -> None:
    entry = library.add_path(str(tiny_capture))
    with pytest.raises(InputError, match="is being computed"):
        entry.start_run("fast", [])
    wait(entry)
    library.start_run(entry, "fast", ["geometry.iteration=3"])
    assert wait(entry) == "failed" and "geometry" in entry.document()["sentence"]
    assert (entry.preset, entry.settings) == ("fast", ("geometry.iteration=3",))
    entry.start_check()
    assert wait(entry) == "checked"


class EndedProcess(HirProcess):
    """A command that has ended."""

    def __init__(self, sentence: str, *, stopped: bool = False) -> None:
        self.end_sentence, self.stopped = sentence, stopped

    is_running = property(lambda self: False)  # type: ignore[assignment]
    has_failed = property(lambda self: not self.stopped)  # type: ignore[assignment]
    was_stopped = property(lambda self: self.stopped)  # type: ignore[assignment]
    sentence = property(lambda self: self.end_sentence)  # type: ignore[assignment]


def entry_with_finished_run(folder: Path) -> CaptureEntry:
    """Of files that the page looks at, without a reconstruction."""
    (folder / "run" / "exports").mkdir(parents=True)
    (folder / "run" / "exports" / "cow.glb").write_bytes(b"glTF")
    (folder / "run" / "report.html").write_text("<html></html>")
    (folder / "run" / "run.json").write_text(
        json.dumps({"format": FORMAT, "version": VERSION, "stages": {LAST_STAGE: {"report": {}, "warnings": []}}})
    )
    return CaptureEntry(folder, "cow", folder)


@pytest.mark.parametrize("stopped", [False, True])
def test_a_later_run_that_fails_or_is_stopped_leaves_the_files_of_a_finished_one(tmp_path: Path, stopped: bool) -> None:
    """A misspelled setting must not hide the result; it is hidden while a run may replace it."""
    entry = entry_with_finished_run(tmp_path)
    entry.run = EndedProcess("unknown option", stopped=stopped)
    document = entry.document()
    assert document["state"] == ("stopped" if stopped else "failed")
    assert document["run"]["has_result"]
    assert [file["path"] for file in document["run"]["files"]] == ["cow.glb"]
    assert list(entry.exported_files()) == ["cow.glb"]
    (tmp_path / "run" / "run.json").write_text(json.dumps({"format": FORMAT, "version": VERSION, "stages": {}}))
    assert not entry.document()["run"]["has_result"] and entry.exported_files() == {}


def test_a_check_that_fails_beside_a_finished_run_says_why(tmp_path: Path) -> None:
    entry = entry_with_finished_run(tmp_path)
    entry.check = EndedProcess("/photographs does not exist")
    document = entry.document()
    assert (document["state"], document["check_sentence"]) == ("finished", "/photographs does not exist")


def test_a_stopped_check_and_the_end_of_a_session(library: CaptureLibrary, tiny_capture: Path) -> None:
    entry = library.add_path(str(tiny_capture))
    entry.stop()
    assert wait(entry) == "new", "stopped before it could finish"
    entry.start_check()
    process = entry.check
    assert process is not None
    library.close()
    assert not process.is_running


def test_output_of_a_command_is_kept_in_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "python"
    program.write_text(
        f"#!{sys.executable}\nimport sys\nsys.stderr.write('x' * 100_000 + '\\n')\n"
        "for i in range(1000): print('line', i, file=sys.stderr)\nsys.exit(3)\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    process = HirProcess([], tmp_path / "out.txt")
    process._process.wait(20)
    assert process.sentence == "line 999" and len(process._lines) == KEPT_LINES


def test_a_process_that_is_ended_by_the_system_is_named(tmp_path: Path) -> None:
    process = HirProcess(["check", str(tmp_path)], tmp_path / "out.txt")
    process._process.kill()
    process._process.wait()
    assert process.has_failed and "ended by the system (SIGKILL)" in process.sentence


def test_nothing_is_imported_from_the_current_folder(
    tiny_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numpy.py").write_text("raise SystemExit('imported from the current folder')")
    monkeypatch.chdir(tmp_path)
    process = HirProcess(["--version"], tmp_path / "out.txt")
    process._process.wait(60)
    assert not process.has_failed and "hir" in (tmp_path / "out.txt").read_text()


def test_sigterm_ends_the_command_and_its_processes(tiny_capture: Path, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "hir_core.cli", "ui", str(tmp_path / "library"), "--no-browser"]
    server = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    assert server.stdout.readline().startswith("http://127.0.0.1:")
    server.terminate()
    assert server.wait(20) in (0, 130)
    server.stdout.close()
    with closing(CaptureLibrary(tmp_path / "library")) as library:
        assert library.entries == []
