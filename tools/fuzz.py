"""Runs every reader on mutated files for a given time; any exception but `HirError` is a finding.

    python tools/fuzz.py [--seconds 600] [--only NAME…] [--findings FOLDER] [--plain]

Each target of tests/reliability/fuzz_targets.py gets a process of its own and an equal share of the time. With atheris
(pip install atheris) libFuzzer steers by the branches of our code that a change reaches; without it, or with --plain,
changes are drawn at random. A process may take 4 GiB and a file 10 s. The bytes of a finding are kept, those before a
process's sudden end, too (NAME.last); exit code 1.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import subprocess
import sys
import time
import traceback
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

MEMORY_BYTES = 4 << 30
SECONDS_A_FILE = 10


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--findings", type=Path, default=ROOT / "build" / "fuzz")
    parser.add_argument("--plain", action="store_true", help="random mutations without atheris")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.findings.mkdir(parents=True, exist_ok=True)
    if options.child:
        return child(options.child, options.seconds, options.findings, options.plain)
    from tests.reliability.fuzz_targets import TARGETS

    names = [t.name for t in TARGETS if not options.only or t.name in options.only]
    share, failed = options.seconds / len(names), []
    for name in names:
        (options.findings / f"{name}.txt").unlink(missing_ok=True)
        arguments = [sys.executable, __file__, "--child", name, "--seconds", str(share), "--findings", options.findings]
        done = subprocess.run(
            [*map(str, arguments), *(["--plain"] if options.plain else [])], capture_output=True, text=True
        )
        tried = next((line for line in done.stdout.splitlines() if line.startswith("tried ")), "died")
        print(f"{name:<22} {tried}", flush=True)
        if done.returncode:
            failed.append(name)
            output = options.findings / f"{name}.txt"
            why = output.read_text() if output.is_file() else done.stdout + done.stderr
            print("\n".join([f"exit code {done.returncode}", *why.splitlines()[-25:]]), flush=True)
    print(
        f"{len(names)} targets, {options.seconds:.0f} s: "
        + (f"findings in {', '.join(failed)}" if failed else "no finding")
    )
    return 1 if failed else 0


def child(name: str, seconds: float, findings: Path, plain: bool) -> int:
    """Fuzzes one target; 0 if nothing was found."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    warnings.simplefilter("ignore")
    engine = None if plain else _atheris()
    if engine is not None:
        with engine.instrument_imports(
            include=["hir_core", "hir_plugins", "hir_exporters"], enable_loader_override=False
        ):
            from tests.reliability.fuzz_targets import TARGETS, remove_folders
    else:
        from tests.reliability.fuzz_targets import TARGETS, remove_folders
    from tests.reliability.mutations import mutated

    target = next(t for t in TARGETS if t.name == name)
    seeds = target.seeds()
    # what a target imports when it runs is imported now, so that no time of the first file goes there
    target(seeds[0])
    rng, tried, ends = random.Random(0), 0, time.monotonic() + seconds
    last = findings / f"{name}.last"

    def attack(data: bytes) -> None:
        nonlocal tried
        tried += 1
        last.write_bytes(data)  # native code may end the process, which leaves no time to write
        started = time.monotonic()
        try:
            target(data)
        except BaseException:
            (findings / name).write_bytes(data)
            (findings / f"{name}.txt").write_text(traceback.format_exc())  # libFuzzer closes stderr
            raise
        took = time.monotonic() - started
        if took > SECONDS_A_FILE:
            (findings / name).write_bytes(data)
            raise TimeoutError(f"{took:.1f} s")
        if time.monotonic() > ends:
            print(f"tried {tried} files", flush=True)
            last.unlink()
            remove_folders()
            sys.stdout.flush()
            os._exit(0)

    try:
        if engine is None:
            while True:
                attack(mutated(rng.choice(seeds), rng))

        def changed(data: bytes, most: int, seed: int) -> bytes:
            # half of the changes keep the structure of text and JSON, which libFuzzer knows nothing of
            draw = random.Random(seed)
            return mutated(data, draw)[:most] if draw.random() < 0.5 else engine.Mutate(data, most)

        corpus = findings / f"{name}.corpus"
        corpus.mkdir(exist_ok=True)
        for number, seed in enumerate(seeds):
            (corpus / f"seed-{number}").write_bytes(seed)
        arguments = [
            sys.argv[0],
            str(corpus),
            "-rss_limit_mb=0",
            "-verbosity=0",
            "-close_fd_mask=2",
            "-max_len=65536",
            f"-artifact_prefix={findings}/libfuzzer-",
        ]
        engine.Setup(arguments, attack, custom_mutator=changed)
        engine.Fuzz()
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        remove_folders()
        return 1
    return 0


def _atheris():  # type: ignore[no-untyped-def]
    try:
        import atheris
    except ImportError:
        return None
    return atheris


if __name__ == "__main__":
    sys.exit(main())
