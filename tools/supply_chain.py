"""Dependencies of `hir`: build/sbom.json (CycloneDX), and known vulnerabilities if their database is reachable.

    python tools/supply_chain.py [--extras reconstruct]

Needs cyclonedx-bom and pip-audit (pip install 'hir[audit]'). Lists what is installed here of hir's dependencies and
theirs; exit code 1 where a vulnerability is known.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--extras", nargs="*", default=["reconstruct"])
    pins = closure("hir", frozenset(parser.parse_args().extras))
    pins.pop("hir", None)
    out = ROOT / "build" / "sbom.json"
    out.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / "requirements.txt"
        listed.write_text("".join(f"{name}=={version}\n" for name, version in sorted(pins.items())))
        write_sbom(listed, out)
        return audit(listed)


def closure(root: str, extras: frozenset[str]) -> dict[str, str]:
    """Versions of all installed distributions that `root[extras]` needs, `root` included; others are skipped."""
    found: dict[str, str] = {}
    waiting, done = [(root, extras)], set()
    while waiting:
        name, wanted = waiting.pop()
        if (name, wanted) in done:
            continue
        done.add((name, wanted))
        try:
            installed = distribution(name)
        except PackageNotFoundError:
            continue
        # local builds (1.0+cpu) have the vulnerabilities of the release
        found[name] = installed.version.partition("+")[0]
        for line in installed.requires or ():
            needed = Requirement(line)
            if needed.marker is None or any(needed.marker.evaluate({"extra": e}) for e in (*wanted, "")):
                waiting.append((re.sub(r"[-_.]+", "-", needed.name).lower(), frozenset(needed.extras)))
    return found


def write_sbom(requirements: Path, out: Path) -> None:
    """A CycloneDX document of pinned requirements."""
    arguments = [
        "requirements",
        str(requirements),
        "--pyproject",
        str(ROOT / "pyproject.toml"),
        "--of",
        "JSON",
        "--output-reproducible",
        "-o",
        str(out),
    ]
    subprocess.run([sys.executable, "-m", "cyclonedx_py", *arguments], check=True)
    document = json.loads(out.read_text())
    print(f"{out}: {document['bomFormat']} {document['specVersion']}, {len(document['components'])} components")


def audit(requirements: Path) -> int:
    """1 where pip-audit finds a vulnerability; prints the number of audited packages."""
    arguments = ["-r", str(requirements), "--no-deps", "--disable-pip", "--progress-spinner", "off", "-f", "json"]
    done = subprocess.run([sys.executable, "-m", "pip_audit", *arguments], capture_output=True, text=True)
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError):
        packages = []
    audited = [p for p in packages if "skip_reason" not in p]
    if not audited:
        print("vulnerabilities: the database cannot be reached from here, so none was looked up")
        return 0
    known = [f"{p['name']} {p['version']}: {v['id']}" for p in audited for v in p["vulns"]]
    print(f"vulnerabilities: {len(known)} known in {len(audited)} of {len(packages)} packages")
    print("\n".join(known))
    return 1 if known else 0


if __name__ == "__main__":
    sys.exit(main())
