"""Every block of the tutorials is executed: files are written, settings loaded, commands run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.docs.blocks import BLOCK, Reader
from tests.fixtures.runs import QUICK, make_tiny

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = [*sorted((DOCS / "writing_plugins").glob("*.md")), DOCS / "plugin_api.md", DOCS / "architecture.md"]
TUTORIALS = [page for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))]
FAST = ("regularizer.md", "observer.md", "plugin_api.md", "architecture.md")


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, id=page.stem, marks=[] if page.name in FAST else [pytest.mark.slow]) for page in TUTORIALS],
)
def test_every_block_of_the_page_runs(page: Path, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    reader.follow(page)
    blocks = [language for language, _ in BLOCK.findall(page.read_text(encoding="utf-8")) if language != "text"]
    assert len(reader.done) >= len(blocks) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["index.md", "regularizer.md", "mask_source.md", "observer.md", "exporter.md"])
def test_whole_runs_of_the_page(name: str, tmp_path: Path) -> None:
    """The commands that need photographs or a finished run, too: on a tiny capture, with settings that are quick."""
    make_tiny(tmp_path / "photos")
    quick = tuple(word for setting in QUICK for word in ("--set", setting))
    if name == "exporter.md":
        first = Reader(tmp_path / "first", quick, run_heavy=True)
        first._command(f"hir reconstruct {tmp_path / 'photos'} -o {tmp_path / 'run'}")
    reader = Reader(tmp_path / "work", quick, run_heavy=True)
    for shared in ("photos", "run"):
        if (tmp_path / shared).exists():
            shutil.move(tmp_path / shared, tmp_path / "work" / shared)
    if name == "mask_source.md":
        pytest.skip("its photographs stand before a blue wall, which the tiny capture does not have")
    page = DOCS / "writing_plugins" / name
    runs = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("hir reconstruct")]
    reader.follow(page)
    assert set(runs) <= set(reader.done)
    if runs:
        assert (tmp_path / "work" / "run" / "report.html").is_file()
