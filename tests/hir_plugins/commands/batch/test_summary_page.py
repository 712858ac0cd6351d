"""batch.html: worst first, sortable, escaped, one file."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.storage_path import StoragePath
from hir_plugins.commands.batch.summary.summary_page import write_page

PIXEL = "data:image/jpeg;base64,/9j/4AAQSkZJRgABAQ=="


def done(psnr: float | None, seconds: float, *warnings: str) -> dict[str, object]:
    figures = {"object": psnr, "frame": None if psnr is None else psnr + 6}
    return {
        "state": "done",
        "source": "s3://captures/x",
        "psnr": figures,
        "stage_seconds": {"geometry": seconds},
        "warnings": list(warnings),
        "retries": 0,
    }


CAPTURES = {
    "jug": done(31.5, 9.0),
    "cup <b>": done(24.25, 100.0, "geometry: 3 photographs disagree <i>"),
    "pot": {"state": "failed", "source": "pot", "reason": "initialization: pot/03.png is cut off", "retries": 2},
    "vase": {"state": "running", "source": "vase", "retries": 0},
    "bowl": done(None, 4.0),
}


def rows(document: str) -> list[str]:
    return re.findall(r'<tr class="\w+" data-name="([^"]*)"', document)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    destination = Destination(StoragePath(str(tmp_path / "results")))
    destination.write_record("jug", {"thumbnail": PIXEL})
    destination.write_record("cup <b>", {"thumbnail": 'x" onerror="alert(1)'})
    write_page(destination, CAPTURES, "2026-01-01T00:00:00+00:00")
    return tmp_path / "results" / "batch.html"


def test_worst_come_first_and_all_text_is_escaped(written: Path) -> None:
    text = written.read_text(encoding="utf-8")
    assert rows(text) == ["pot", "bowl", "cup &lt;b&gt;", "jug", "vase"]
    assert "pot/03.png is cut off" in text and 'href=".batch/logs/pot.log"' in text
    assert "<i>" not in text.split("<tbody>")[1] and "onerror" not in text and PIXEL in text
    assert 'href="cup%20%3Cb%3E/report.html"' in text
    assert not re.findall(r"\{[{%]", text) and not re.findall(r'(?:src|href)="https?:', text)
    assert "<b>3</b><span>done" in text and "<b>1</b><span>failed" in text and "<b>27.9 dB</b>" in text


def test_large_batch_shows_its_worst(tmp_path: Path) -> None:
    write_page(Destination(StoragePath(str(tmp_path))), CAPTURES, "now", max_rows=2)
    text = (tmp_path / "batch.html").read_text(encoding="utf-8")
    assert rows(text) == ["pot", "bowl"] and "The other 3 captures are not displayed" in text


def test_page_sorts_and_filters_in_a_browser(written: Path, chromium: list[str], tmp_path: Path) -> None:
    script = """{
      const press = (key) => document.querySelector(`#captures button[data-key=${key}]`).click();
      const order = () => [...document.querySelectorAll('#captures tbody tr:not([hidden])')]
        .map((row) => row.dataset.name).join('|');
      const found = [order()];
      press('seconds'); found.push(order());
      press('seconds'); found.push(order());
      press('name'); found.push(order());
      const filter = document.getElementById('filter');
      filter.value = 'cut off'; filter.oninput(); found.push(order());
      document.body.dataset.found = JSON.stringify(found);
    }"""
    text = written.read_text(encoding="utf-8").replace("</body>", f"<script>{script}</script></body>")
    scripted = tmp_path / "scripted.html"
    scripted.write_text(text, encoding="utf-8")
    command = [*chromium, f"--user-data-dir={tmp_path}", "--dump-dom", "--virtual-time-budget=2000", scripted.as_uri()]
    document = subprocess.run(command, capture_output=True, text=True, timeout=90, check=True).stdout
    (found,) = re.findall(r'data-found="([^"]*)"', document)
    cup = "cup &lt;b&gt;"
    assert found.replace("&quot;", '"').replace("&amp;lt;", "&lt;") in (
        f'["pot|bowl|{cup}|jug|vase","bowl|jug|{cup}|pot|vase","{cup}|jug|bowl|pot|vase",'
        f'"bowl|{cup}|jug|pot|vase","pot"]'
    )


def test_page_is_written_to_the_store(memory: StoragePath) -> None:
    write_page(Destination(memory), CAPTURES, "now")
    assert rows((object_store.read(memory / "batch.html") or b"").decode())[0] == "pot"
