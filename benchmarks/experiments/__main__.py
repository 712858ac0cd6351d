"""`python -m benchmarks.experiments [STUDY…] [--minutes M]`: runs cells that have no result, then writes the page."""

from __future__ import annotations

import argparse
import subprocess
import time

from benchmarks.experiments.page import write_page
from benchmarks.experiments.studies import STUDIES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", choices=[[], *STUDIES], help="Default: all.")
    parser.add_argument("--minutes", type=float, default=0.0, help="Stop after M minutes; the next call continues.")
    parser.add_argument(
        "--page", action="store_true", help="Only write docs/studies/paper_experiments.md from the results there are."
    )
    options = parser.parse_args()
    end = time.monotonic() + 60 * options.minutes if options.minutes else None
    names = options.studies or list(STUDIES)
    for name in () if options.page else names:
        for label, cell in STUDIES[name].rows:
            if cell.stored() is not None:
                continue
            if cell.source() is None:
                print(f"{name}: {label}: its capture {cell.capture} is not on this machine", flush=True)
                continue
            left = None if end is None else end - time.monotonic()
            if left is not None and left <= 0:
                print("out of time; the next call continues", flush=True)
                return
            started = time.monotonic()
            try:
                cell.run(left)
            except subprocess.TimeoutExpired:
                print(f"{name}: {label}: not finished; the next call continues", flush=True)
                return
            print(f"{name}: {label}: {time.monotonic() - started:.0f} s", flush=True)
    print(write_page())


if __name__ == "__main__":
    main()
