"""Contracts that find several faults: each fault has its own sentence."""

from __future__ import annotations

import pytest

from hir_core.plugins import Component
from hir_core.plugins.manager import PluginManager
from hir_core.testing import check_component
from hir_core.testing.running import as_registered
from tests.hir_core.testing import (
    broken_exporters,
    broken_initializers,
    broken_inputs,
    broken_readers,
    broken_regularizers,
)


def reader(implementation: type) -> Component:
    return broken_inputs.reader(implementation, module=broken_readers.HERE)


OWN_FORMAT, PIXELS, CAMERAS = "knows_its_own_format", "pixels_are_linear", "cameras_are_where_they_were"
READERS = [
    (reader(broken_readers.NoSaturation), PIXELS, "`saturated` of view 00 is None; it must be an array of bool"),
    (reader(broken_readers.SaturationOfChannels), PIXELS, "`saturated` of view 00 is bool (48, 48, 3); it must be"),
    (reader(broken_readers.AllSaturated), PIXELS, "true for 100 % of a photograph whose brightest value is 0.8"),
    (reader(broken_readers.DoublePrecision), PIXELS, "the colours of view 00: float64, not float32"),
    (reader(broken_readers.OtherSize), PIXELS, "is for 96 × 48 pixels, its picture has 48 × 48"),
    (reader(broken_readers.ListOfViews), OWN_FORMAT, "the capture's views are a list, which could change later"),
    (reader(broken_readers.ReadsNothing), CAMERAS, "read() returns None; return a Capture"),
    (reader(broken_readers.SameSplits), OWN_FORMAT, "the split 'test' has 6 of the photographs of 'train'"),
    (reader(broken_readers.MatchesPictures), OWN_FORMAT, "matches() says yes to a folder of photographs;"),
    (reader(broken_readers.MatchesJson), OWN_FORMAT, "matches() says yes to a capture of the format open_mvg"),
]
FINITE, IDEAL = "term_is_a_finite_scalar", "smallest_on_its_ideal"
made = broken_regularizers.made
REGULARIZERS = [
    (made(broken_regularizers.RootOfZero), IDEAL, "values of the gradient by positions are not finite"),
    (made(testing=f"{broken_regularizers.HERE}:no_scene"), IDEAL, "testing returns None; return the scene"),
    (made(broken_regularizers.PreparesNothing), FINITE, "prepare returns None; return a function of the scene"),
    (made(broken_regularizers.WithoutArgument), FINITE, "cannot be called with the scene alone: too many positional"),
]
RESULT, MASKS, BACK = "returns_capture_and_scene", "masks_are_the_true_ones", "reads_back"
surface, mask_source = broken_initializers.surface, broken_inputs.mask_source
obj, ply, corners = broken_exporters.obj, broken_exporters.ply, broken_exporters.corners
INITIALIZERS = [
    (surface(broken_initializers.InsideOut), RESULT, "its triangles face inwards"),
    (surface(broken_initializers.FromOne), RESULT, "triangles name the vertices 1 … "),
    (surface(broken_initializers.Empty), RESULT, "the mesh has no triangles"),
    (surface(broken_initializers.ReportsNothing), RESULT, "report() returns NoneType; return a dict"),
    (surface(broken_initializers.ReportsArrays), RESULT, "report() cannot be written as JSON"),
    (surface(broken_initializers.ScansAName), RESULT, "scan() returns str; return a Scan or None"),
]
READS_FILES = frozenset({"reads_files"})
SOURCES = [
    (mask_source(broken_inputs.TupleOfMasks), MASKS, "masks returns a tuple; return a list of numpy arrays"),
    (mask_source(broken_inputs.NoMasks), MASKS, "masks returns None; return a list of numpy arrays"),
    (mask_source(broken_inputs.NestedLists), MASKS, "a list with a list; return a list of numpy arrays"),
    (mask_source(broken_inputs.NeedsCameras), MASKS, "has no camera"),
    (mask_source(broken_inputs.NeedsPoints), MASKS, "no view of a capture made for it gets a mask"),
    (mask_source(broken_inputs.NoFiles, READS_FILES), MASKS, "files() returns None; return a list of paths"),
    (mask_source(broken_inputs.MissingFiles, READS_FILES), MASKS, "no_such_file.png, which is no file"),
]
EXPORTERS = [
    (obj(broken_exporters.DownwardV), BACK, "texture coordinates of a corner are off by"),
    (obj(broken_exporters.InwardNormals), BACK, "normals of a corner are off by 2"),
    (obj(broken_exporters.OnlyPositions), BACK, "has no texture coordinates and no normals and no material, and its"),
    (ply(broken_exporters.PlyDownwardV), BACK, "texture coordinates of a corner are off by"),
    (ply(broken_exporters.PlyInwardNormals), BACK, "normals of a corner are off by 2"),
    (ply(broken_exporters.PlyWithoutAWord), BACK, "the file has no material, and its report has no warning"),
    (obj(broken_exporters.NamesNoPicture), BACK, "it names no_such_picture.png, which it does not write"),
    (obj(broken_exporters.NamesNoMaterials), BACK, "it names no_such_library.mtl, which it does not write"),
    (obj(broken_exporters.OneWarning), BACK, "write a tuple of sentences"),
    (corners(broken_exporters.Corners), BACK, "no byte depends on its texture coordinates and its normals and its mat"),
    (corners(broken_exporters.CornersWithNormals), BACK, "no byte depends on its texture coordinates and its material"),
    (obj(broken_exporters.NoReport), BACK, "write returns None; return an ExportReport"),
]
TABLE = {
    "capture_reader": READERS,
    "regularizer": REGULARIZERS,
    "initializer": INITIALIZERS,
    "mask_source": SOURCES,
    "exporter": EXPORTERS,
}
CASES = [(kind, *case) for kind, cases in TABLE.items() for case in cases]


@pytest.fixture(scope="module")
def plugins() -> PluginManager:
    return PluginManager.discover()


@pytest.mark.parametrize(
    ("kind", "component", "check", "said"),
    CASES,
    ids=[f"{case[2]}-{case[1].target.rpartition(':')[2]}-{case[1].testing.rpartition(':')[2]}" for case in CASES],
)
def test_the_fault_is_named(kind: str, component: Component, check: str, said: str, plugins: PluginManager) -> None:
    results = check_component(as_registered(kind, component), plugins=plugins, only=[check], raises=False)
    (detail,) = [result.detail for result in results if result.outcome == "failed"]
    assert f"breaks the contract {check!r}" in detail and said in detail
