"""report.html in a browser: its script runs, its pictures are there, it asks the network for nothing."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np

from hir_core.curves import curve_svg, thinned
from hir_core.evaluation import spread
from hir_core.pipeline import Run
from hir_core.report_pictures import light_picture


def test_page_works_in_a_browser(finished: Run, chromium: list[str], tmp_path: Path) -> None:
    page = finished.path / "report.html"
    words = [
        *chromium,
        f"--user-data-dir={tmp_path}",
        "--dump-dom",
        "--virtual-time-budget=3000",
        page.as_uri(),
    ]
    done = subprocess.run(words, capture_output=True, text=True, timeout=90, check=True)
    document = done.stdout
    assert len(re.findall(r'class="slide shown"', document)) == 1, "the script chose the first view"
    assert f"1 of {len(re.findall('class=.slide', document))}" in document
    sources = re.findall(r'<img[^>]* src="([^"]{20})', document)
    assert len(sources) >= 4 * 3 + 4 and all(source.startswith("data:image/jpeg;") for source in sources)
    assert not re.findall(r"<!--\w+-->", document), "every place of the template is filled"


def test_curve_of_many_steps_is_thinned_and_finite() -> None:
    steps, values = thinned(np.arange(10_000.0), np.where(np.arange(10_000) % 7, 1.0, np.nan))
    assert len(steps) == len(values) == 400 and (values == 1).all()
    assert "nan" not in curve_svg("flat <loss>", np.arange(5), np.zeros(5))
    assert "&lt;loss&gt;" in curve_svg("flat <loss>", np.arange(5), np.zeros(5))
    assert curve_svg("one", np.arange(1), np.zeros(1)) == ""


def test_views_are_spread_from_first_to_last() -> None:
    assert spread(24, 4) == [0, 8, 15, 23]
    assert spread(2, 4) == [0, 1] and spread(1, 4) == [0] and spread(0, 4) == []


def test_black_light_is_a_black_picture() -> None:
    assert light_picture(np.zeros((4, 8, 3), np.float32)).max() == 0
