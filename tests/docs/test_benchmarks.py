"""docs/benchmarks.md, its plots and README's table are what tools/write_benchmarks.py makes of the stored results."""

from __future__ import annotations

import filecmp

from tests.docs.test_site import ROOT, tool

TOOL = tool("write_benchmarks")
ADVICE = "run: python tools/write_benchmarks.py"


def test_page_is_what_the_results_give() -> None:
    assert TOOL.page() == (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8"), ADVICE


def test_table_of_the_readme_is_that_of_the_results() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.count(TOOL.BEGIN) == 1 and readme.count(TOOL.END) == 1
    assert TOOL.with_table(readme) == readme, ADVICE
    assert TOOL.runs_table(TOOL.whole_runs()) in readme


def test_plots_are_those_of_the_results() -> None:
    plots = list(TOOL.RESULTS.glob("*.svg"))
    assert plots
    for plot in plots:
        assert filecmp.cmp(plot, TOOL.IMAGES / f"bench_{plot.name}", shallow=False), ADVICE
