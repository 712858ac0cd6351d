"""Writes docs/benchmarks.md, its plots and the tables of README and docs/reflectance.md; tests compare.

`python tools/write_benchmarks.py [--runs RUN…]`: with runs, the figures of finished and evaluated runs are first stored
in benchmarks/results/whole_runs.json, where those of other captures stay. `hir bench … -o benchmarks/results` writes
the other files. Plots are drawn from them to docs/images, the one place of generated figures; those that `hir bench`
wrote are removed.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from hir_core.run.machine import source_commit
from hir_plugins.commands.bench.results.bench_result import Result
from hir_plugins.commands.bench.results.markdown_tables import machine_line, result_markdown
from hir_plugins.commands.bench.results.plot import plot_svg

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "benchmarks.md"
IMAGES = ROOT / "docs" / "images"
README = ROOT / "README.md"
BEGIN, END = "<!-- whole runs, by tools/write_benchmarks.py -->", "<!-- end of whole runs -->"
REFLECTANCE = ROOT / "docs" / "reflectance.md"
SHADING_BEGIN, SHADING_END = "<!-- shading, by tools/write_benchmarks.py -->", "<!-- end of shading -->"

TEMPLATE = Path(__file__).with_name("benchmarks.template.md")
SUITES = ("geometry", "shading", "reflectance", "materials", "regularizers", "export", "initializers", "end-to-end")


def whole_runs() -> list[dict[str, Any]]:
    """The stored figures of finished runs."""
    path = RESULTS / "whole_runs.json"
    return list(json.loads(path.read_text(encoding="utf-8"))["runs"]) if path.is_file() else []


def run_figures(run: Path) -> dict[str, Any]:
    """Settings, seconds, memory and metrics of a finished and evaluated run, from its JSON documents."""
    document = json.loads((run / "run.json").read_text(encoding="utf-8"))
    timings = json.loads((run / "timings.json").read_text(encoding="utf-8"))
    first = next(iter(json.loads((run / "capture" / "cameras.json").read_text(encoding="utf-8"))["views"]))
    test = json.loads((run / "evaluation" / "test" / "metrics.json").read_text(encoding="utf-8"))
    # one thread: processor time equals wall-clock time on an idle machine; several threads: only wall-clock time does
    seconds = "processor_seconds" if timings["machine"].get("threads") == 1 else "seconds"
    stored_metrics = (
        "psnr",
        "psnr_scaled",
        "ssim",
        "lpips",
        "flip",
        "iou",
        "light",
        "surface",
        "albedo",
        "light_error",
    )
    return {
        "capture": document["capture"]["name"],
        "preset": document["settings"]["preset"],
        "views": document["capture"]["views"],
        "side": max(first["width"], first["height"]),
        "stages": {name: stage[seconds] for name, stage in timings["stages"].items()}
        | {"report": timings["report"][seconds]},
        "peak_memory_bytes": max(stage["peak_memory_bytes"] for stage in timings["stages"].values()),
        "seconds_per_view": round(sum(view["seconds"] for view in test["views"]) / len(test["views"]), 2),
        "threads": timings["machine"].get("threads"),
        "processor": timings["machine"]["processor"],
        "date": timings["finished"][:10],
        "commit": source_commit(),
        "model": document["stages"]["reflectance"]["report"].get("model"),
        "metrics": {split: {k: m[k] for k in stored_metrics if k in m} for split, m in document["metrics"].items()},
    }


def updated(stored: list[dict[str, Any]], measured: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The stored runs, with those of the same captures replaced and new captures at the end."""
    rows = {run["capture"]: run for run in stored} | {run["capture"]: run for run in measured}
    return list(rows.values())


def runs_table(runs: list[dict[str, Any]]) -> str:
    """README's table."""
    lines = [
        "| capture | minutes | unseen views, frame / object | SSIM | relit, frame (scaled per channel) |",
        "|---|---|---|---|---|",
    ]
    for run in runs:
        seconds = sum(run["stages"].values())
        threads = f" ({run['threads']} thread{'s' if run['threads'] != 1 else ''})" if run["threads"] else ""
        test = run["metrics"]["test"]
        relit = ", ".join(
            f"{m['psnr']['frame']:.1f} ({m['psnr_scaled']['frame']:.1f})"
            for m in (run["metrics"][split] for split in sorted(run["metrics"]))
            if not m["light"]["fitted"]
        )
        lines.append(
            f"| {run['capture']}, {run['views']} × {run['side']}² | {seconds / 60:.1f}{threads} "
            f"| {test['psnr']['frame']:.1f} / {test['psnr']['object']:.1f} dB | {test['ssim']:.3f} "
            f"| {relit + ' dB' if relit else '–'} |"
        )
    return "\n".join(lines)


def stages_table(runs: list[dict[str, Any]]) -> str:
    """Seconds of each stage, peak memory and selected model of each run."""
    names = list(dict.fromkeys(name for run in runs for name in run["stages"]))
    order = [n for n in ("initializer", "geometry", "atlas", "reflectance", "bake", "export", "report") if n in names]
    lines = ["| capture | " + " | ".join(order) + " | peak memory | model |", "|---|" + "---|" * (len(order) + 2)]
    for run in runs:
        cells = [f"{run['stages'][name]:.1f} s" if name in run["stages"] else "–" for name in order]
        memory = f"{run['peak_memory_bytes'] / 2**30:.1f} GiB"
        lines.append(f"| {run['capture']} | " + " | ".join([*cells, memory, str(run["model"])]) + " |")
    return "\n".join(lines)


def page() -> str:
    """docs/benchmarks.md."""
    runs = whole_runs()
    days = ", ".join(dict.fromkeys(run["date"] for run in runs))
    parts = {
        "runs": runs_table(runs),
        "stages": stages_table(runs),
        "origin": f"{runs[0]['processor']}, no GPU; {days}." if runs else "",
        **{suite: section(suite) for suite in SUITES},
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"<!--{name}-->", part)
    return text


def plot(suite: str) -> Path:
    """The plot of a suite's results."""
    return IMAGES / f"bench_{suite}.svg"


def section(suite: str) -> str:
    """Table and plot of one suite."""
    path = RESULTS / f"{suite}.json"
    if not path.is_file():
        return "Not measured yet."
    result = Result.read(path)
    text = result_markdown(result).rstrip()
    if result.settings.get("quick"):
        text += " The smallest sizes alone (`--quick`)."
    if plot(suite).is_file():
        text += f"\n\n![hir bench {suite}: seconds as cases grow, and against error](images/bench_{suite}.svg)"
    return text


def with_table(readme: str) -> str:
    """README with the table of the stored results between its markers."""
    return between(readme, BEGIN, END, runs_table(whole_runs()))


def with_shading(text: str) -> str:
    """docs/reflectance.md with the accuracy of `transport_ggx` between its markers."""
    return between(text, SHADING_BEGIN, SHADING_END, shading_table())


def between(text: str, begin: str, end: str, block: str) -> str:
    """`text` with `block` in place of what is between two markers."""
    before, _, rest = text.partition(begin)
    _, _, after = rest.partition(end)
    return f"{before}{begin}\n{block}\n{end}{after}"


def shading_table() -> str:
    """Errors of `transport_ggx` by scene, light and GGX width, from benchmarks/results/shading.json."""
    result = Result.read(RESULTS / "shading.json")
    lines = ["| scene | light | α | mean error | bias | outline error |", "|---|---|---|---|---|---|"]
    for row in result.rows:
        if row.method == "transport_ggx":
            cells = [str(value) for value in row.case.values()]
            cells += [f"{100 * row.errors['mean error']:.1f} %", f"{100 * row.errors['bias']:+.1f} %".replace("-", "−")]
            cells.append(f"{100 * row.errors['outline error']:.1f} %")
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", f"(`hir bench shading`; {machine_line(result)})"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", nargs="*", type=Path, default=[])
    options = parser.parse_args()
    if options.runs:
        RESULTS.mkdir(parents=True, exist_ok=True)
        document = {
            "commit": source_commit(),
            "runs": updated(whole_runs(), [run_figures(run) for run in options.runs]),
        }
        text = json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False)
        (RESULTS / "whole_runs.json").write_text(text + "\n", encoding="utf-8")
    for suite in SUITES:
        if (RESULTS / f"{suite}.json").is_file():
            plot(suite).write_text(plot_svg(Result.read(RESULTS / f"{suite}.json")), encoding="utf-8")
        (RESULTS / f"{suite}.svg").unlink(missing_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
    REFLECTANCE.write_text(with_shading(REFLECTANCE.read_text(encoding="utf-8")), encoding="utf-8")
    README.write_text(with_table(README.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
