"""The table of third-party readers: its verdicts, its page, and readers that are not installed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.mesh.convex_decomposition import ConvexHull
from readers.__main__ import results
from readers.comparison import expected, verdict
from readers.page import PAGE, RESULTS, page
from readers.programs import READERS, Description, NotRunError, Reader
from readers.variants import Variant, export_variant, made_asset, variants

BY_NAME = {reader.name: reader for reader in READERS}
CHOSEN = {variant.name: variant for variant in variants()}
WANT = replace(expected(made_asset()), textures={"color": 1024, "normal": 1024})
FOUND = {
    "triangles": WANT.triangles,
    "low": WANT.low,
    "high": WANT.high,
    "meshes": ["asset"],
    "textures": {"color": [1024, 1024], "normal": "named"},
}


def test_what_is_as_exported_is_read() -> None:
    assert verdict(FOUND, WANT) == "read"
    assert verdict({**FOUND, "ignored": ["MSFT_lod"]}, WANT) == "read, ignores MSFT_lod"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"triangles": 3}, "differs: 3 triangles instead of 960"),
        ({"high": [9.0, 9.0, 9.0]}, "differs: the bounding box is off by"),
        ({"low": [float("nan")] * 3}, "differs: positions are not finite"),
        ({"meshes": ["a", "b"]}, "differs: 2 meshes instead of 1"),
        ({"textures": {"color": [1024, 1024]}}, "differs: no texture for normal"),
        (
            {"textures": {"color": [512, 1024], "normal": [1024, 1024]}},
            "differs: the color texture has 512 × 1024 pixels",
        ),
    ],
)
def test_each_difference_is_named(change: dict[str, object], said: str) -> None:
    assert verdict({**FOUND, **change}, WANT).startswith(said)


def test_errors_and_missing_readers_are_never_read() -> None:
    assert verdict({"error": "no\n such extension"}, WANT) == "refused: no such extension"
    assert verdict({"error": ""}, WANT) == "refused: without a message"
    assert verdict(None, WANT) == "not run"


def test_names_of_hulls_must_arrive() -> None:
    want = replace(WANT, hulls="UCX_")
    assert verdict({**FOUND, "meshes": ["asset", "UCX_asset_00"]}, want) == "read"
    assert verdict({**FOUND, "meshes": ["asset", "mesh.001"]}, want).startswith("differs: meshes are")
    assert verdict(FOUND, want).startswith("differs: meshes are"), "the hulls are missing"


def test_a_reader_that_is_not_there_is_not_run() -> None:
    def absent() -> str:
        raise NotRunError("it is not installed")

    def broken(files: Sequence[Path]) -> list[Description]:
        raise NotRunError("its program ended with 1")

    readers = [
        Reader("absent", frozenset({"gltf"}), BY_NAME["trimesh"].read, absent, "get it"),
        Reader("broken", frozenset({"gltf"}), broken, lambda: "2", "get it"),
    ]
    khr = CHOSEN["glb --profile khr"]
    document = results(made_asset(), readers, [khr, CHOSEN["obj"]])
    assert document["results"] == {
        khr.name: {"absent": "not run", "broken": "not run"},
        "obj": {"absent": "—", "broken": "—"},
    }
    text = page(document)
    assert "| `glb --profile khr` | not run | not run |" in text
    assert "- absent was not run: it is not installed. To run it: `get it`." in text


def test_trimesh_reads_an_exported_file() -> None:
    document = results(made_asset(), [BY_NAME["trimesh"]], [CHOSEN["glb --profile khr"]])
    assert document["results"]["glb --profile khr"]["trimesh"] == "read"
    assert document["readers"]["trimesh"]["version"] == trimesh.__version__


@pytest.mark.parametrize("reader", [reader for reader in READERS if reader.name != "trimesh"], ids=lambda r: r.name)
def test_hulls_arrive_in_readers_by_their_names(
    reader: Reader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For trimesh and usd-core: tests/hir_exporters/mesh/test_collision.py."""
    try:
        reader.version()
    except NotRunError as error:
        pytest.skip(f"{error}: {reader.install}")
    boxes = [trimesh.creation.box((0.2, 0.3, 0.2)), trimesh.creation.box((0.1, 0.1, 0.2))]
    hulls = tuple(ConvexHull(box.vertices.astype(np.float32), box.faces.astype(np.int32)) for box in boxes)
    for module in ("gltf.gltf_exporter", "usd.usd_exporter"):
        monkeypatch.setattr(f"hir_exporters.{module}.convex_hulls", lambda mesh, count: hulls)
    chosen = [variant for variant in HULL_VARIANTS if variant.kind in reader.kinds]
    found = reader.read([export_variant(variant, made_asset(), tmp_path) for variant in chosen])
    for variant, description in zip(chosen, found, strict=True):
        names = [name for name in description["meshes"] if name.startswith(variant.hulls) or variant.hulls in name]
        assert len(names) == 2 and len(description["meshes"]) == 3, (variant.name, description)
        assert verdict(description, expected(made_asset(), variant.hulls)) == "read"


HULL_VARIANTS = [
    variant
    for variant in variants()
    if variant.hulls  # none without coacd
]


def test_the_page_is_that_of_the_stored_results() -> None:
    document = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert PAGE.read_text(encoding="utf-8") == page(document), "run: make readers"
    assert list(document["readers"]) == [reader.name for reader in READERS]
    missing = set(CHOSEN) - set(document["results"])
    assert not missing, f"run make readers: {missing}"


def test_no_reader_of_a_core_file_refuses_it() -> None:
    """glTF without extensions that are required is read by all that were run."""
    document = json.loads(RESULTS.read_text(encoding="utf-8"))
    for profile in ("khr", "blender", "metalrough", "unity-legacy", "engine"):
        for suffix in ("glb", "gltf"):
            cells = document["results"][f"{suffix} --profile {profile}"]
            assert set(cells.values()) <= {"read", "not run"}, (suffix, profile)


def test_variants_are_kinds_of_files(tmp_path: Path) -> None:
    kinds = {variant.kind for variant in CHOSEN.values()}
    assert kinds == {"gltf", "usd", "obj"}
    assert isinstance(CHOSEN["usdz"], Variant) and export_variant(CHOSEN["usdz"], made_asset(), tmp_path).is_file()
