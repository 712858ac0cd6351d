"""The captures that a user named: patterns, lists, and one job for each."""

from __future__ import annotations

from collections.abc import Iterable

from hir_core.errors import InputError
from hir_plugins.commands.batch.retries import call_with_retries
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.layout import RESERVED_NAMES, Destination
from hir_plugins.commands.batch.storage.storage_path import StoragePath, parse_storage_path


def capture_jobs(captures: Iterable[str], destination: Destination) -> list[CaptureJob]:
    """One job for each capture, named by the last part of its address.

    Raises `InputError` for equal names of different captures, for invalid names, and if there is no capture.
    """
    jobs: dict[str, CaptureJob] = {}
    for text in captures:
        source = parse_storage_path(text)
        name = source.name
        if not name or name.startswith(".") or name in RESERVED_NAMES:
            raise InputError(f"{source} cannot be a capture: its result would be named {name!r}")
        other = jobs.get(name)
        if other is not None and other.source != source.url:
            raise InputError(
                f"two captures have the name {name!r}: {other.source} and {source}; "
                "rename one, or process them in two batches with two destinations"
            )
        if source.url == destination.result(name).url:
            raise InputError(f"the result of {source} would replace the capture itself; choose another destination")
        jobs[name] = CaptureJob(name, source.url)
    if not jobs:
        raise InputError("no capture was given; name captures as arguments or in a file with --from")
    return list(jobs.values())


def expand_patterns(arguments: Iterable[str]) -> list[str]:
    """The addresses as they were typed; a pattern such as `s3://bucket/*` is replaced by what it matches."""
    captures: list[str] = []
    for argument in arguments:
        if not any(character in argument for character in "*?["):
            captures.append(argument)
            continue
        matches = _matches(argument)
        if not matches:
            raise InputError(f"{argument} matches nothing")
        captures += matches
    return captures


def read_capture_list(text: str) -> list[str]:
    """The captures that a file names, one per line; empty lines and lines that begin with # are ignored."""
    path = parse_storage_path(text)
    content = object_store.read(path)
    if content is None:
        raise InputError(f"{path} does not exist; give a file with one capture per line")
    lines = [line.strip() for line in content.decode("utf-8", errors="replace").splitlines()]
    return [line for line in lines if line and not line.startswith("#")]


def _matches(pattern: str) -> list[str]:
    local = StoragePath(pattern).local
    if local is not None and local.exists():
        return [pattern]
    path = parse_storage_path(pattern)
    file_system, location = path.open()
    matches = call_with_retries(lambda: file_system.glob(location), f"{pattern} cannot be listed")
    prefix = "" if path.local is not None else path.url.removesuffix(location.lstrip("/"))
    return [f"{prefix}{match.lstrip('/') if prefix else match}" for match in sorted(matches)]
