"""The page of `hir ui` in a browser: from a dropped folder to downloaded files, by mouse and by keyboard."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from hir_core.run.run_directory import FORMAT, LAST_STAGE, VERSION
from hir_plugins.commands.ui.capture_entry import new_entry
from hir_plugins.commands.ui.ui_server import UiServer
from tests.fixtures.browser_session import BrowserSession
from tests.fixtures.runs import QUICK

STATE = "document.documentElement.dataset.state"
FOCUS = "document.activeElement.id"


@pytest.fixture(scope="module")
def session(chromium: list[str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserSession]:
    folder = tmp_path_factory.mktemp("browser")
    with BrowserSession(chromium, folder / "profile", folder) as session:
        yield session


@pytest.fixture
def browser(server: UiServer, session: BrowserSession, tmp_path: Path) -> Iterator[BrowserSession]:
    """The page of a server; what it stores belongs to the server's port."""
    session.problems.clear()
    session.send("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "downloads"))
    session.open(server.address)
    session.wait_for(f"{STATE} === 'empty'")
    yield session
    session.send("Page.navigate", url="about:blank")


def checked(browser: BrowserSession) -> None:
    """Waits for the contact sheet, too: until it is displayed, what is below it moves."""
    in_state(browser, "checked")
    browser.wait_for("document.querySelector('.sheet img')?.naturalWidth > 100")


def in_state(browser: BrowserSession, state: str, seconds: float = 60) -> None:
    browser.wait_for(f"{STATE} === '{state}'", seconds)


@pytest.fixture
def dropped(tiny_capture: Path, tmp_path: Path) -> Path:
    """A capture as people have it: with files that do not belong to it."""
    folder = tmp_path / "Clay <cow> & co"
    shutil.copytree(tiny_capture, folder)
    (folder / ".DS_Store").write_bytes(b"x")
    (folder / "train" / "Thumbs.db").write_bytes(b"x")
    return folder


def test_a_dropped_folder_is_copied_and_checked(server: UiServer, browser: BrowserSession, dropped: Path) -> None:
    browser.drop("#drop", [dropped])
    in_state(browser, "checked")
    entry = server.library.entry("Clay--cow----co")
    assert entry is not None
    sent = {path.relative_to(dropped): path.read_bytes() for path in dropped.rglob("*") if path.is_file()}
    arrived = {path.relative_to(entry.source): path.read_bytes() for path in entry.source.rglob("*") if path.is_file()}
    hidden = {Path(".DS_Store"), Path("train/Thumbs.db")}
    assert arrived == {path: content for path, content in sent.items() if path not in hidden}
    text = browser.text("#photographs")
    assert "10 photographs of 64×64, 10 with cameras, 10 with masks" in text
    check = json.loads(entry.check_document.read_text())
    assert check["advice"] and all(sentence in text for sentence in check["advice"])
    browser.wait_for("document.querySelector('.sheet img').naturalWidth > 100")
    assert len(browser.evaluate("[...document.querySelectorAll('tbody tr')].map(r => r.innerText)")) == 10
    assert browser.evaluate(FOCUS) == "capture-title", "the heading of what was added has the focus"
    assert browser.text("#status") == "Clay--cow----co: ready", "what a screen reader says"
    assert browser.problems == []


@pytest.mark.slow
def test_a_failure_is_a_sentence_and_can_be_mended(server: UiServer, browser: BrowserSession, dropped: Path) -> None:
    """By keyboard alone: a path, its check, a setting with a misspelled name, and the mended setting."""
    browser.evaluate("document.querySelector('#path').focus()")
    browser.type("nowhere")
    browser.press("Enter")
    browser.wait_for("document.querySelector('#add-error').textContent.includes('whole path of a folder')")
    browser.evaluate("document.querySelector('#path').select()")
    browser.type(str(dropped))
    browser.press("Enter")
    in_state(browser, "checked")
    assert browser.text("#add-error") == ""
    assert browser.evaluate("document.querySelector('[name=preset]:checked').value") == "fast"
    for _ in range(20):
        browser.press("Tab")
        if browser.evaluate("document.activeElement.name") == "preset":
            break
    browser.press("Tab")
    browser.press("Enter")  # opens the settings
    browser.press("Tab")
    assert browser.evaluate(FOCUS) == "settings"
    browser.type("geometry.iteration=3")
    browser.press("Tab")
    assert browser.evaluate(FOCUS) == "start"
    browser.press("Enter")
    in_state(browser, "failed")
    [entry] = server.library.entries
    assert entry.run is not None and "geometry" in entry.run.sentence
    assert browser.text("#run-sentence [role=alert]") == entry.run.sentence
    assert browser.text("#start") == "Try again"
    assert browser.evaluate("document.querySelector('#settings').value") == "geometry.iteration=3"
    browser.evaluate("document.querySelector('#settings').select()")
    browser.type("not a setting")
    browser.click("#start")
    browser.wait_for("document.querySelector('#start-error').textContent.includes('write KEY=VALUE')")
    refused = [problem for problem in browser.problems if "400" not in problem]
    assert refused == [], "refused requests are noted by the browser; nothing else is"


def test_what_cannot_be_read_says_so(browser: BrowserSession, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    browser.drop("#drop", [tmp_path / "notes"])
    browser.wait_for("document.querySelector('#add-error').textContent === 'notes holds no files.'")
    (tmp_path / "notes" / "a.txt").write_text("no photograph")
    browser.drop("#drop", [tmp_path / "notes"])
    in_state(browser, "check_failed")
    assert "is no capture that an installed reader knows" in browser.text("#photographs [role=alert]")
    assert browser.evaluate("document.querySelector('#reconstruction').hidden")
    assert browser.problems == []


def test_the_address_opens_the_last_capture(server: UiServer, browser: BrowserSession, tmp_path: Path) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.txt").write_text("no photograph")
        browser.drop("#drop", [tmp_path / name])
        browser.wait_for(f"document.querySelector('#capture-title')?.textContent.startsWith('{name}')")
        in_state(browser, "check_failed")
    browser.evaluate("location.hash = '#first'")
    browser.wait_for("document.querySelector('#capture-title')?.textContent.startsWith('first')")
    browser.send("Page.reload")
    browser.wait_for("document.querySelector('#capture-title')?.textContent.startsWith('first')")
    browser.open("about:srcdoc")
    browser.open(server.address)
    browser.wait_for("document.querySelector('#capture-title')?.textContent.startsWith('second')")


def test_every_control_has_a_name(browser: BrowserSession, dropped: Path) -> None:
    """As assistive technology sees the page: roles and names that the browser computes."""
    browser.drop("#drop", [dropped])
    in_state(browser, "checked")
    browser.send("Accessibility.enable")
    nodes = browser.send("Accessibility.getFullAXTree")["nodes"]
    controls = {"button", "textbox", "radio", "link", "progressbar", "image", "region", "heading"}
    found = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in nodes
        if not node.get("ignored") and node["role"]["value"] in controls
    ]
    assert {role for role, _ in found} >= {"button", "textbox", "radio", "image", "heading"}
    assert [role for role, name in found if not name.strip()] == []
    assert sum(role == "heading" for role, _ in found) >= 5


@pytest.mark.slow
def test_a_lost_server_is_said(server: UiServer, browser: BrowserSession) -> None:
    server.token = "gone"
    browser.wait_for("document.querySelector('#connection').textContent.includes('Start hir ui again')")


def test_a_capture_is_removed_after_a_question(server: UiServer, browser: BrowserSession, dropped: Path) -> None:
    browser.drop("#drop", [dropped])
    checked(browser)
    [entry] = server.library.entries
    browser.click("#remove")
    assert browser.evaluate(FOCUS) == "keep", "the harmless button has the focus"
    assert "deletes the copied photographs" in browser.text("#removal")
    browser.click("#keep")
    assert entry.folder.is_dir() and browser.evaluate("document.querySelector('#confirm-removal')") is None
    browser.click("#remove")
    browser.click("#confirm-removal")
    in_state(browser, "empty")
    assert server.library.entries == [] and not entry.folder.exists()
    assert dropped.is_dir() and browser.text("#empty") == "None yet."
    assert browser.problems == []


@pytest.mark.slow
def test_a_finished_run_keeps_its_files_and_a_failed_check_says_why(
    server: UiServer, browser: BrowserSession, tmp_path: Path
) -> None:
    """The check is damaged, as a full disk leaves it, and the photographs have been moved."""
    folder = server.library.folder / "cow"
    for name in ("check", "run/exports"):
        (folder / name).mkdir(parents=True)
    (folder / "check" / "sheet.png").write_bytes(b"")
    (folder / "check" / "check.json").write_bytes(b'{"views": [')
    (folder / "run" / "exports" / "cow.glb").write_bytes(b"glTF")
    (folder / "run" / "report.html").write_text("<html></html>")
    run = {"format": FORMAT, "version": VERSION, "stages": {LAST_STAGE: {"report": {}, "warnings": []}}}
    (folder / "run" / "run.json").write_text(json.dumps(run))
    server.library._entries["cow"] = new_entry(folder, "cow", tmp_path / "moved")
    in_state(browser, "finished")
    browser.wait_for("document.querySelector('#photographs')?.innerText.includes('have not been checked')")
    assert "cow.glb" in browser.text("#result")
    browser.click("#check")
    browser.wait_for("document.querySelector('#photographs [role=alert]')?.innerText.includes('does not exist')")
    assert "cow.glb" in browser.text("#result")
    browser.evaluate("document.querySelector('#settings-details').open = true")
    browser.evaluate("document.querySelector('#settings').focus()")
    browser.type("geometry.iteration=3")
    browser.click("#start")
    in_state(browser, "failed")
    assert "The latest one failed." in browser.text("#result") and "cow.glb" in browser.text("#result")


@pytest.mark.slow
def test_the_mesh_of_a_scan_is_asked_for(server: UiServer, browser: BrowserSession, dropped: Path) -> None:
    """Only by the preset for scans; a mesh among the photographs is offered, and a wrong name is a sentence."""
    (dropped / "scan.obj").write_text("v 0 0 0\n")
    browser.drop("#drop", [dropped])
    checked(browser)
    assert browser.evaluate("document.querySelector('#scan-field').hidden")
    browser.click("[name=preset][value=delight]")
    assert not browser.evaluate("document.querySelector('#scan-field').hidden")
    offered = browser.evaluate("[...document.querySelectorAll('#scans option')].map(o => o.value)")
    assert "scan.obj" in offered, "beside meshes that the capture itself has"
    browser.evaluate("document.querySelector('#scan').select()")
    browser.type("nowhere.obj")
    browser.click("#start")
    browser.wait_for("document.querySelector('#start-error').textContent.includes('nowhere.obj is no file')")
    browser.evaluate("document.querySelector('#scan').select()")
    browser.type("scan.obj")
    browser.click("#start")
    in_state(browser, "failed", 120)  # its mesh has no triangles
    [entry] = server.library.entries
    assert "scan.obj" in browser.text("#run-sentence [role=alert]")
    assert (entry.preset, entry.scan) == ("delight", "scan.obj")
    assert browser.evaluate("document.querySelector('#scan').value") == "scan.obj"


@pytest.mark.slow
def test_from_drop_to_download(server: UiServer, browser: BrowserSession, dropped: Path, tmp_path: Path) -> None:
    """The real commands on a small capture: started, stopped, resumed, finished."""
    browser.drop("#drop", [dropped])
    in_state(browser, "checked")
    browser.evaluate("document.querySelector('#settings-details').open = true")
    browser.evaluate("document.querySelector('#settings').focus()")
    browser.type("\n".join(QUICK))
    browser.click("#start")
    in_state(browser, "running")
    browser.wait_for("document.querySelector('.stages .current')?.innerText.includes('geometry')", 120)
    assert "Now stage 2 of 6: geometry." in browser.text("#progress")
    browser.wait_for("document.querySelector('.stages .facts')?.innerText.includes('step ')", 120)
    browser.wait_for("document.querySelector('#run-preview img')?.naturalWidth > 100", 30)
    browser.click("#stop")
    in_state(browser, "stopped")
    assert browser.text("#start") == "Resume"
    assert "Finished stages are kept" in browser.text("#progress")
    assert browser.evaluate("document.querySelector('#settings').value").split("\n") == list(QUICK)
    browser.open(server.address)  # another page finds the same run
    in_state(browser, "stopped")
    browser.click("#start")
    in_state(browser, "running")
    in_state(browser, "finished", 300)
    [entry] = server.library.entries
    assert "initializer: reused" in entry.run_directory.log.read_text()
    assert browser.evaluate("document.querySelectorAll('.stages .done').length") == 6
    browser.wait_for("document.querySelector('#run-preview img').naturalWidth > 100", 30)
    browser.click("#archive")
    downloaded = tmp_path / "downloads" / f"{entry.id}.zip"
    for _ in range(100):
        if downloaded.is_file():
            break
        browser.wait_for("new Promise(done => setTimeout(() => done(true), 100))")
    exported = {path.name: path.read_bytes() for path in entry.run_directory.exports.iterdir()}
    with zipfile.ZipFile(downloaded) as archive:
        assert {Path(name).name: archive.read(name) for name in archive.namelist()} == exported
    assert any(name.endswith(".glb") for name in exported)
    browser.open(browser.evaluate("document.querySelector('#report').href"))
    browser.wait_for("document.querySelector('iframe#model')?.src.startsWith('blob:')")
    assert browser.evaluate("origin") == "null", "the report cannot act as the page"
    assert entry.name in browser.text("h1")
    assert browser.problems == []
