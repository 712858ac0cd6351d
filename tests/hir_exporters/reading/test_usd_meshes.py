"""Meshes of USD files that other programs wrote."""

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import InputError
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.usd_reading.usd_readback import read_usd
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from tests.hir_exporters.reading.usd_samples import (
    NORMALS,
    POINTS,
    QUADS,
    SIZE,
    ST,
    add_box,
    box_of,
    transform,
    volume,
    write_box,
)

Edit = Callable[[Usd.Stage], object]


def _assert_box(path: Path, low: object = (0, 0, 0), high: object = SIZE) -> None:
    """Twelve triangles of a box, counter-clockwise from outside, with the normals of its sides."""
    back = read_usd(path, in_meters=True)
    positions = back.corner_positions
    assert positions.shape == (12, 3, 3)
    np.testing.assert_allclose([positions.min((0, 1)), positions.max((0, 1))], [low, high], atol=1e-6)
    assert volume(positions) == pytest.approx(np.prod(np.subtract(high, low)), rel=1e-6)
    normals = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(back.corner_normals, np.repeat(normals[:, None], 3, axis=1), atol=1e-6)


def test_quads_are_two_triangles_each(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    _assert_box(path)
    uvs = read_usd(path).corner_uvs
    areas = np.linalg.det(uvs[:, 1:] - uvs[:, :1]) / 2
    np.testing.assert_allclose(areas, -0.5)  # v is downwards
    np.testing.assert_array_equal(uvs[0], [[0, 1], [1, 1], [1, 0]])


def _uniform(stage: Usd.Stage) -> None:
    box_of(stage).GetNormalsAttr().Set(NORMALS)
    box_of(stage).SetNormalsInterpolation("uniform")


def _indexed(stage: Usd.Stage) -> None:
    """An indexed primvar of normals, which precedes the attribute."""
    primvar = UsdGeom.PrimvarsAPI(box_of(stage)).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "uniform")
    primvar.Set(NORMALS[::-1])
    primvar.SetIndices(Vt.IntArray(range(5, -1, -1)))
    box_of(stage).GetNormalsAttr().Set([(0, 1, 0)] * 24)


def _long(stage: Usd.Stage) -> None:
    box_of(stage).GetNormalsAttr().Set([tuple(4.0 * c for c in normal) for normal in NORMALS for _ in range(4)])


@pytest.mark.parametrize("edit", [_uniform, _indexed, _long])
def test_normals_of_every_interpolation_are_those_of_the_sides(edit: Edit, tmp_path: Path) -> None:
    _assert_box(write_box(tmp_path, edit))


@pytest.mark.parametrize("interpolation", ["vertex", "varying"])
def test_texture_coordinates_of_points(interpolation: str, tmp_path: Path) -> None:
    values = [(z / 3, y / 2) for _, y, z in POINTS]

    def edit(stage: Usd.Stage) -> None:
        st = UsdGeom.PrimvarsAPI(box_of(stage)).GetPrimvar("st")
        st.SetInterpolation(interpolation)
        st.Set(values)

    back = read_usd(write_box(tmp_path, edit))
    expected = back.corner_positions[..., [2, 1]] / [3, 2] * [1, -1] + [0, 1]
    np.testing.assert_allclose(back.corner_uvs, expected, atol=1e-6)


def test_indexed_texture_coordinates_are_those_without_indices(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        st = UsdGeom.PrimvarsAPI(box_of(stage)).GetPrimvar("st")
        st.Set(ST[3::-1])
        st.SetIndices(Vt.IntArray([3, 2, 1, 0] * 6))

    (tmp_path / "indexed").mkdir()
    actual, expected = read_usd(write_box(tmp_path / "indexed", edit)), read_usd(write_box(tmp_path))
    np.testing.assert_array_equal(actual.corner_uvs, expected.corner_uvs)


def test_a_wrong_number_of_values_is_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: box_of(stage).GetNormalsAttr().Set(NORMALS))
    with pytest.raises(InputError, match=r"box.usda: the mesh /Root/Box has 6 normals, .*'faceVarying' needs 24"):
        read_usd(path)


def test_transforms_of_the_mesh_and_its_parents_apply(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        transform(stage, "/Root", (2, 0, 0, 0), (0, 2, 0, 0), (0, 0, 2, 0), (5, 0, 0, 1))
        transform(stage, "/Root/Box", (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1))

    _assert_box(write_box(tmp_path, edit), (5, 2, 0), (7, 6, 6))


def test_a_mirrored_mesh_still_faces_outwards(tmp_path: Path) -> None:
    mirror = ((-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    _assert_box(write_box(tmp_path, lambda stage: transform(stage, "/Root", *mirror)), (-1, 0, 0), (0, 2, 3))


def test_normals_of_a_sheared_mesh_are_perpendicular_to_it(tmp_path: Path) -> None:
    shear = ((1, 0, 0, 0), (0.5, 1, 0, 0), (0, 0, 4, 0), (0, 0, 0, 1))
    back = read_usd(write_box(tmp_path, lambda stage: transform(stage, "/Root", *shear)))
    corners = back.corner_positions
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
    np.testing.assert_allclose(np.einsum("fec,fkc->fek", edges, back.corner_normals), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(back.corner_normals, axis=-1), 1)


def test_a_transform_without_an_inverse_is_refused(tmp_path: Path) -> None:
    flat = ((1, 0, 0, 0), (0, 0, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    with pytest.raises(InputError, match="the transform of the mesh /Root/Box is singular"):
        read_usd(write_box(tmp_path, lambda stage: transform(stage, "/Root", *flat)))


def test_z_up_becomes_y_up(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z))
    _assert_box(path, (0, 0, -2), (1, 3, 0))


@pytest.mark.parametrize(("unit", "factor"), [(0.01, 0.01), (None, 0.01), (2.0, 2.0)])
def test_an_import_is_in_metres(unit: float | None, factor: float, tmp_path: Path) -> None:
    """Without metadata the unit is a centimetre, as the specification says."""

    def edit(stage: Usd.Stage) -> None:
        if unit is None:
            stage.ClearMetadata("metersPerUnit")
        else:
            UsdGeom.SetStageMetersPerUnit(stage, unit)

    path = write_box(tmp_path, edit)
    _assert_box(path, (0, 0, 0), SIZE * factor)
    np.testing.assert_allclose(load_mesh_asset(path).mesh.positions.max(axis=0), SIZE * factor, rtol=1e-6)
    np.testing.assert_allclose(read_usd(path).corner_positions.max((0, 1)), SIZE)


def test_left_handed_polygons_are_turned_around(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        attribute = box_of(stage).GetFaceVertexIndicesAttr()
        quads = np.asarray(attribute.Get()).reshape(-1, 4)[:, ::-1]
        attribute.Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(quads.reshape(-1))))
        box_of(stage).CreateOrientationAttr("leftHanded")

    _assert_box(write_box(tmp_path, edit))


def test_missing_normals_are_smooth(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: box_of(stage).GetPrim().RemoveProperty("normals"))
    back = read_usd(path)
    # A right angle of each of the three sides meets at every corner of the box.
    expected = np.where(back.corner_positions > 0, 1, -1) / np.sqrt(3)
    np.testing.assert_allclose(back.corner_normals, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("scheme", "normals", "warned"),
    [("none", False, False), ("loop", True, True), (None, True, False), (None, False, True)],
)
def test_a_subdivision_surface_is_its_control_cage(
    scheme: str | None, normals: bool, warned: bool, tmp_path: Path
) -> None:
    def edit(stage: Usd.Stage) -> None:
        mesh = box_of(stage)
        mesh.GetPrim().RemoveProperty("subdivisionScheme")
        if scheme is not None:
            mesh.CreateSubdivisionSchemeAttr(scheme)
        if not normals:
            mesh.GetPrim().RemoveProperty("normals")

    path = write_box(tmp_path, edit)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert volume(read_usd(path).corner_positions) == pytest.approx(6)
    assert [("control cage" in str(warning.message)) for warning in caught] == [True] * warned


def test_the_creases_of_a_subdivision_surface_are_named(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        box_of(stage).GetPrim().RemoveProperty("subdivisionScheme")
        box_of(stage).CreateCreaseIndicesAttr([0, 1])
        box_of(stage).CreateCreaseLengthsAttr([2])
        box_of(stage).CreateCreaseSharpnessesAttr([10.0])

    with pytest.warns(
        UserWarning, match=r"is a subdivision surface \(catmullClark with creases\), of which the control"
    ):
        read_usd(write_box(tmp_path, edit))


@pytest.mark.parametrize("triangles", [False, True])
def test_holes_are_left_out(triangles: bool, tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        box = box_of(stage)
        if triangles:
            corners = np.arange(24).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].ravel()
            box.GetFaceVertexIndicesAttr().Set([QUADS[corner // 4][corner % 4] for corner in corners])
            box.GetFaceVertexCountsAttr().Set([3] * 12)
            box.GetNormalsAttr().Set([NORMALS[corner // 4] for corner in corners])
            UsdGeom.PrimvarsAPI(box).GetPrimvar("st").Set([ST[corner] for corner in corners])
        box.CreateHoleIndicesAttr([2, 3] if triangles else [1])

    back = read_usd(write_box(tmp_path, edit))
    assert back.corner_positions.shape == (10, 3, 3)
    assert not (back.corner_normals == NORMALS[1]).all(axis=-1).any() and back.corner_positions.max() == 3


def test_a_mesh_of_holes_is_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: box_of(stage).CreateHoleIndicesAttr(list(range(6))))
    with pytest.raises(InputError, match=r"box.usda: mesh.faces contains no triangles \(its polygons are holes"):
        read_usd(path)


def test_meshes_of_one_material_are_joined(tmp_path: Path) -> None:
    back = read_usd(write_box(tmp_path, lambda stage: add_box(stage, "/Root/Other", 10.0)))
    assert len(back.corner_positions) == 24 and volume(back.corner_positions) == pytest.approx(12)
    assert back.corner_positions.max() == 11


def _invisible(stage: Usd.Stage) -> None:
    UsdGeom.Imageable(stage.GetPrimAtPath("/Root/Group")).MakeInvisible()


def _purpose(purpose: str) -> Edit:
    return lambda stage: UsdGeom.Imageable(stage.GetPrimAtPath("/Root/Group")).CreatePurposeAttr(purpose)


def _inactive(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Root/Group").SetActive(False)


@pytest.mark.parametrize("hide", [_invisible, _purpose("guide"), _purpose("proxy"), _inactive])
def test_what_a_render_does_not_show_is_left_out(hide: Edit, tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        UsdGeom.Xform.Define(stage, "/Root/Group")
        add_box(stage, "/Root/Group/Hidden", 10.0)
        hide(stage)

    _assert_box(write_box(tmp_path, edit))


def test_a_file_that_shows_no_mesh_is_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: box_of(stage).MakeInvisible())
    with pytest.raises(InputError, match=r"box.usda: mesh.faces contains no triangles \(it has no mesh that is visi"):
        read_usd(path)


def test_instances_are_read(tmp_path: Path) -> None:
    write_box(tmp_path)
    stage = Usd.Stage.CreateNew(str(tmp_path / "two.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Y")
    for index in range(2):
        instance = UsdGeom.Xform.Define(stage, f"/Instance{index}")
        instance.GetPrim().GetReferences().AddReference("./box.usda")
        instance.GetPrim().SetInstanceable(True)
        instance.AddTranslateOp().Set(Gf.Vec3d(10 * index, 0, 0))
    stage.Save()
    back = read_usd(tmp_path / "two.usda")
    assert len(back.corner_positions) == 24 and volume(back.corner_positions) == pytest.approx(12)
    assert back.corner_positions.max() == 11 and back.surface.base_color.shape == (2, 2, 3)


def test_point_instancers_are_refused_and_other_shapes_are_warned_of(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: UsdGeom.Sphere.Define(stage, "/Root/Ball"))
    with pytest.warns(UserWarning, match=r"box.usda has prims of the type Sphere, which are left out"):
        assert len(read_usd(path).corner_positions) == 12
    (tmp_path / "points").mkdir()
    path = write_box(tmp_path / "points", lambda stage: UsdGeom.PointInstancer.Define(stage, "/Root/Many"))
    with pytest.raises(InputError, match="/Root/Many is a point instancer; make its instances meshes first"):
        read_usd(path)


def test_indices_out_of_range_are_refused(tmp_path: Path) -> None:
    for index in (8, -1):
        folder = tmp_path / str(index)
        folder.mkdir()
        path = write_box(folder, lambda s, i=index: box_of(s).GetFaceVertexIndicesAttr().Set([i] * 24))
        with pytest.raises(InputError, match=r"mesh.faces has an index out of range \(/Root/Box has 8 points\)"):
            read_usd(path)


def test_counts_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: box_of(stage).GetFaceVertexCountsAttr().Set([4] * 5))
    with pytest.raises(InputError, match="have 20 corners in faceVertexCounts and 24 in faceVertexIndices"):
        read_usd(path)


def test_a_damaged_package_is_one_clean_sentence(tmp_path: Path) -> None:
    path = tmp_path / "bad.usdz"
    path.write_bytes(b"PK\3\4bad")
    with pytest.raises(InputError) as caught:
        load_mesh_asset(path)
    message = str(caught.value)
    assert message.startswith(f"{path} cannot be read as USD (Failed to open layer") and "\n" not in message
    assert "pxrInternal" not in message and ".cpp" not in message


def test_a_missing_layer_is_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda s: s.GetPrimAtPath("/Root").GetReferences().AddReference("./gone.usda"))
    with pytest.raises(
        InputError, match=r"box.usda lacks a part \(Could not open asset .*gone.usda.*put the file beside"
    ):
        read_usd(path)


def test_a_skeleton_is_left_out_with_a_warning(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        primvars = UsdGeom.PrimvarsAPI(box_of(stage))
        primvars.CreatePrimvar("skel:jointIndices", Sdf.ValueTypeNames.IntArray, "vertex").Set([0] * 8)

    with pytest.warns(UserWarning, match=r"box.usda has a skeleton, which is left out; apply its pose to the mesh"):
        read_usd(write_box(tmp_path, edit))
