"""Identifiers use the terms of docs/glossary.md: words that the project retired do not return.

Identifiers are split at underscores and capitals. A retired word is refused as a part of a name of the project's own:
variables, parameters, attributes that are assigned, functions, classes, modules. Names of other libraries are used,
not defined, and so are free.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.architecture.import_graph import ROOT

FOLDERS = ("exporters/hir_exporters", "hir_core", "hir_plugins", "tests", "tools", "benchmarks")

RETIRED = {
    "rung": "ModelSpec, spec",
    "climb": "select_model",
    "climbed": "selected",
    "ladder": "model selection",
    "vote": "comparison",
    "votes": "comparisons",
    "settle": "AlbedoRefinement, refine",
    "settled": "refined",
    "settling": "albedo refinement",
    "desk": "WorkerScratch",
    "look": "CaptureStatus",
    "looks": "appearances",
    "patience": "RetryPolicy",
    "apart": "run_in_subprocess",
    "trouble": "non-finite diagnostics",
    "told": "message, on_progress",
    "tell": "report, notify",
    "sighting": "observation",
    "sightings": "observations",
    "hold": "prior",
    "holds": "priors",
    "unknowns": "Parameters",
    "tilt": "shading normal, normal_offset",
    "tilts": "shading normals",
    "bending": "shading normals",
    "bent": "perturbed",
    "stream": "mini-batches",
    "turns": "shards",
    "closing": "closed-form albedo",
    "starts": "initial guesses",
    "untangle": "repair self-intersections",
    "untangling": "self-intersection repair",
    "spread": "dilate",
    "places": "SurfaceSamples, positions, paths",
    "stamp": "FileStat, hash",
    "stamps": "FileStat, hash",
    "rests": "is frozen",
}
"""Retired word → what is used in its place."""

RETIRED_PHRASES = {
    "energy_guard": "energy conservation",
    "view_trust": "robust view weights",
    "mask_residue": "silhouette residual",
    "loose_pieces": "floating components",
}

EXCEPTIONS = {
    "look_at": "the usual name of a function that orients a camera",
    "look_up": "the verb of a table look-up",
    "quick_look": "Apple's AR Quick Look, which opens .usdz files",
    "hold_out": "the verb of held-out views",
    "stream": "a file object of Python's io",
    "tell": "the method of a file object",
}
"""Terms of the field or of Python that contain a retired word, each with the reason."""

VERBS = {"closing", "hold", "holds", "look", "looks", "places", "rests", "spread", "starts", "tell", "turns"}
"""Retired nouns that are also ordinary verbs: the name of a test is a sentence, and may use them."""

SELF = "tests/architecture/test_vocabulary.py"


def words_of(identifier: str) -> set[str]:
    """Lower-case words of an identifier, split at underscores, digits and capitals."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", identifier)}


def snake_case(identifier: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", identifier).lower()


def defined_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and name of everything that a module defines or assigns."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and _is_self(node.value):
            yield node.lineno, node.attr
        elif isinstance(node, ast.alias) and node.asname:
            yield 0, node.asname
        elif isinstance(node, ast.ExceptHandler) and node.name:
            yield node.lineno, node.name


def _is_self(node: ast.expr) -> bool:
    """Attributes of other objects may be those of another library."""
    return isinstance(node, ast.Name) and node.id == "self"


def retired_words(identifier: str) -> set[str]:
    name = snake_case(identifier)
    for exception in EXCEPTIONS:
        name = re.sub(rf"(?<![a-z]){exception}(?![a-z])", "", name)
    free = VERBS if name.startswith("test_") else set()
    return (words_of(name) & RETIRED.keys()) - free | {phrase for phrase in RETIRED_PHRASES if phrase in name}


def offences(file: Path) -> list[str]:
    path = file.relative_to(ROOT)
    names = [(0, part) for part in path.with_suffix("").parts]
    names += defined_names(ast.parse(file.read_text(encoding="utf-8")))
    everything = {**RETIRED, **RETIRED_PHRASES}
    return sorted(
        {f"{path}:{line}: {name}: {word} → {everything[word]}" for line, name in names for word in retired_words(name)}
    )


@pytest.mark.parametrize("folder", FOLDERS)
def test_identifiers_have_no_retired_word(folder: str) -> None:
    files = [file for file in sorted((ROOT / folder).rglob("*.py")) if "node_modules" not in file.parts]
    assert files
    wrong = [line for file in files if file.relative_to(ROOT).as_posix() != SELF for line in offences(file)]
    assert wrong == [], "\n" + "\n".join(wrong)


def test_words_of_identifiers() -> None:
    assert words_of("RungSpec_toldX2HTTPServer") == {"rung", "spec", "told", "x", "http", "server"}
    assert retired_words("was_told") == {"told"} and retired_words("EnergyGuard") == {"energy_guard"}
    assert (
        not retired_words("look_at")
        and not retired_words("QUICK_LOOK_BYTES")
        and not retired_words("threshold")
        and not retired_words("outlook")
    )
