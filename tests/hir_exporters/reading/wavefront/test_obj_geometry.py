"""The geometry of .obj files, compared with the corners that a parser of a few lines finds in the source."""

from __future__ import annotations

import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import InputError
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.mesh_references import load_mesh_scene

CUBE = """\
# a cube as Blender writes it: 8 positions, 14 texture coordinates, 6 normals
o Cube
v 1.0 1.0 -1.0
v 1.0 -1.0 -1.0
v 1.0 1.0 1.0
v 1.0 -1.0 1.0
v -1.0 1.0 -1.0
v -1.0 -1.0 -1.0
v -1.0 1.0 1.0
v -1.0 -1.0 1.0
vn -0.0 1.0 -0.0
vn -0.0 -0.0 1.0
vn -1.0 -0.0 -0.0
vn -0.0 -1.0 -0.0
vn 1.0 -0.0 -0.0
vn -0.0 -0.0 -1.0
vt 0.625 0.5
vt 0.875 0.5
vt 0.875 0.75
vt 0.625 0.75
vt 0.375 0.75
vt 0.625 1.0
vt 0.375 1.0
vt 0.375 0.0
vt 0.625 0.0
vt 0.625 0.25
vt 0.375 0.25
vt 0.125 0.5
vt 0.375 0.5
vt 0.125 0.75
s 0
"""
QUADS = (
    "1/1/1 5/2/1 7/3/1 3/4/1",
    "4/5/2 3/4/2 7/6/2 8/7/2",
    "8/8/3 7/9/3 5/10/3 6/11/3",
    "6/12/4 2/13/4 4/5/4 8/14/4",
    "2/13/5 1/1/5 3/4/5 4/5/5",
    "6/11/6 5/10/6 1/1/6 2/13/6",
)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"


def source_corners(text: str) -> set[tuple[float, ...]]:
    """Position, texture coordinate and, where it has one, normal of each corner."""
    rows: dict[str, list[tuple[float, ...]]] = {"v": [], "vt": [], "vn": []}
    corners = set()
    for line in text.splitlines():
        keyword, *words = line.split() or [""]
        if keyword in rows:
            rows[keyword].append(tuple(float(word) for word in words))
        elif keyword == "f":
            for word in words:
                values = [
                    rows[kind][int(index) - 1 if int(index) > 0 else int(index)]
                    for kind, index in zip(("v", "vt", "vn"), word.split("/"), strict=False)
                ]
                corners.add(tuple(np.round(np.concatenate(values), 5) + 0.0))
    return corners


def asset_corners(path: Path, normals: bool) -> set[tuple[float, ...]]:
    mesh = load_mesh_asset(path).mesh
    parts = [mesh.positions, mesh.uvs * [1, -1] + [0, 1], *([mesh.normals] if normals else [])]
    rows = np.concatenate([part[mesh.faces.ravel()] for part in parts], axis=1)
    return {tuple(row) for row in np.round(rows, 5) + 0.0}


def faces_of(kind: str) -> str:
    faces = list(QUADS)
    if kind == "triangles":
        corners = [face.split() for face in QUADS]
        faces = [" ".join(three) for c in corners for three in (c[:3], [c[0], *c[2:]])]
    lines = [f"f {face}" for face in faces]
    if kind == "mixed":
        corners = QUADS[0].split()
        lines[:1] = ["f " + " ".join(corners[:3]), "f " + " ".join([corners[0], *corners[2:]])]
    if kind == "groups":
        lines = [line for i, face in enumerate(lines) for line in (f"g part{i}", f"usemtl m{i % 2}", "s off", face)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("kind", ["quads", "triangles", "mixed", "groups"])
@pytest.mark.parametrize("normals", [True, False])
def test_every_corner_is_that_of_the_source(kind: str, normals: bool, tmp_path: Path) -> None:
    faces = faces_of(kind)
    text = CUBE + (faces if normals else "".join(_without_normal(line) for line in faces.splitlines(keepends=True)))
    (tmp_path / "cube.obj").write_text(text)
    expected = source_corners(text)
    assert len(expected) == (24 if normals else 14)
    assert asset_corners(tmp_path / "cube.obj", normals) == expected
    mesh = load_mesh_asset(tmp_path / "cube.obj").mesh
    assert len(mesh.positions) == len(expected) and len(mesh.faces) == 12
    a, b, c = mesh.positions[mesh.faces].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    assert np.linalg.norm(across, axis=1).sum() / 2 == pytest.approx(24)
    assert (across * mesh.normals[mesh.faces[:, 0]]).sum(axis=1).min() > 0


def _without_normal(line: str) -> str:
    words = line.split()
    return " ".join([words[0], *(word.rpartition("/")[0] for word in words[1:])]) + "\n" if words[0] == "f" else line


def test_normals_are_continuous_across_a_seam_of_texture_coordinates(tmp_path: Path) -> None:
    """Without vn: weighted by the angles of all triangles at a position, whatever their texture coordinates."""
    faces = "".join(_without_normal(line) for line in faces_of("quads").splitlines(keepends=True))
    (tmp_path / "cube.obj").write_text(CUBE + faces)
    mesh = load_mesh_asset(tmp_path / "cube.obj").mesh
    np.testing.assert_allclose(mesh.normals, mesh.positions / np.sqrt(3), atol=1e-6)


def test_negative_indices_count_backwards_from_the_face(tmp_path: Path) -> None:
    first = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nf -3/-3/-1 -2/-2/-1 -1/-1/-1\n"
    second = "v 0 0 2\nv 1 0 2\nv 1 1 2\nvt 0 0.5\nvn 0 1 0\nf -3/-1/-1 -2/-2/-1 3/-1/1\n"
    (tmp_path / "a.obj").write_text(first + second)
    expected = source_corners(first) | {
        (0, 0, 2, 0, 0.5, 0, 1, 0),
        (1, 0, 2, 1, 1, 0, 1, 0),
        (1, 1, 0, 0, 0.5, 0, 0, 1),
    }
    assert asset_corners(tmp_path / "a.obj", normals=True) == expected


def test_every_spelling_of_the_same_square(tmp_path: Path) -> None:
    text = SQUARE + "f 1/1/1 2/2/1 3/3/1 4/4/1\n"
    spellings = {
        "plain": text.encode(),
        "mark": b"\xef\xbb\xbf" + text.encode(),
        "tabs": text.replace(" ", "\t").encode(),
        "indented": ("\t" + text.replace("\n", "\n  ")).encode(),
        "windows": text.replace("\n", "\r\n").encode(),
        "old mac": text.replace("\n", "\r").encode(),
        "continued": text.replace("f 1/1/1 2/2/1 ", "f 1/1/1 \\\n2/2/1 \\\n").encode(),
        "comments": text.replace("\n", " # note\n").encode(),
        "no last line": text.strip().encode(),
        "colours": text.replace("v 0 0 0\n", "v 0 0 0 1 0 0\n").encode(),
        "three texture coordinates": text.replace("vt 1 1\n", "vt 1 1 0\n").encode(),
        "latin": b"o m\xf6bel\n" + text.encode(),
    }
    for name, content in spellings.items():
        (tmp_path / "a.obj").write_bytes(content)
        assert asset_corners(tmp_path / "a.obj", normals=True) == source_corners(text), name


def test_a_texture_coordinate_of_one_number_has_a_v_of_zero(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(SQUARE.replace("vt 1 0\n", "vt 1\n") + "f 1/1 2/2 3/3\n")
    assert (1, 0, 0, 1, 0) in asset_corners(tmp_path / "a.obj", normals=False)


COMB = "0,0 7,0 7,4 6,4 6,1 4,1 4,4 3,4 3,1 1,1 1,4 0,4"


@pytest.mark.parametrize("outline", ["0,0 4,0 4,4 3,1", "0,0 4,0 4,4 2,1 0,4", "4,4 3,1 0,0 4,0", COMB])
def test_concave_polygons_are_covered_once(outline: str, tmp_path: Path) -> None:
    points = [tuple(float(x) for x in point.split(",")) for point in outline.split()]
    vertices = "".join(f"v {x} {y} 0\nvt {x / 4} {y / 4}\n" for x, y in points)
    (tmp_path / "a.obj").write_text(vertices + "f " + " ".join(f"{i}/{i}" for i in range(1, len(points) + 1)) + "\n")
    mesh = load_mesh_asset(tmp_path / "a.obj").mesh
    a, b, c = mesh.positions[mesh.faces].transpose(1, 0, 2)
    signed = np.cross(b - a, c - a)[:, 2] / 2
    x, y = np.array(points).T
    assert signed.min() > 0
    assert signed.sum() == pytest.approx((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def test_a_polygon_that_crosses_itself_is_a_warning(tmp_path: Path) -> None:
    crossed = [(0, 0), (4, 0), (4, 4), (2, -2), (0, 4)]
    vertices = "".join(f"v {x} {y} 0\nvt {x / 7} {y / 7}\n" for x, y in crossed)
    (tmp_path / "a.obj").write_text(vertices + "f " + " ".join(f"{i}/{i}" for i in range(1, len(crossed) + 1)) + "\n")
    with pytest.warns(UserWarning, match=r"a\.obj has 1 polygons whose triangles overlap; triangulate the mesh"):
        load_mesh_asset(tmp_path / "a.obj")


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("1/1 2/2 999999999/3", r"mesh\.faces has an index out of range in line 10, v 999999999 of 4"),
        ("1/1 2/2 3/999999999", r"in line 10, vt 999999999 of 4"),
        ("1/1/1 2/2/1 3/3/2", r"in line 10, vn 2 of 1"),
        ("-5/1 2/2 3/3", r"in line 10, v -5 of 4"),
        ("1/1 2/2 99999999999999999999/3", "line 10 that has an index of too many digits"),
        ("1/1 2/2 0/3", "line 10 that has the index 0"),
        ("1/1 2/2 /3", "line 10 that has a corner without a position"),
        ("1/1 2/2 3/3/1/1", "line 10 that has a corner of more than three indices"),
        ("1/1 2/2 x/3", r"line 10 that is not a list of corners v/vt/vn"),
        ("1/1 2/2 3-1", r"line 10 that is not a list of corners v/vt/vn"),
        ("1/1 2/2 1.5/3", r"line 10 that is not a list of corners v/vt/vn"),
        ("1//1 2//1 3//1", r"mesh\.uvs is missing for 1 of 1 triangles"),
        ("1/1 2/2", r"mesh\.faces contains no triangles"),
        ("", r"mesh\.faces contains no triangles"),
    ],
)
def test_a_malformed_face_is_one_sentence_before_memory_is_allocated(face: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(f"{SQUARE}f {face}\n")
    tracemalloc.start()
    with pytest.raises(InputError, match=rf"a\.obj.*{message}") as found:
        load_mesh_asset(tmp_path / "a.obj")
    assert "\n" not in str(found.value)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


@pytest.mark.parametrize(("row", "field"), [("v 1 x 0", "positions"), ("vt", "uvs"), ("vn 0 1", "normals")])
def test_a_malformed_row_is_named_with_its_line(row: str, field: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(f"{SQUARE}{row}\nf 1/1 2/2 3/3\n")
    with pytest.raises(InputError, match=rf"a\.obj: mesh\.{field} does not have (two|three) numbers in line 10"):
        load_mesh_asset(tmp_path / "a.obj")


def test_other_readers_get_the_same_mesh(tmp_path: Path) -> None:
    """`load_mesh_scene`: texture coordinates, else vertex colours; one sentence for an index that is too large."""
    (tmp_path / "cube.obj").write_text(CUBE + faces_of("groups"))
    mesh = load_mesh_scene(tmp_path / "cube.obj", process=False).to_mesh()
    rows = np.concatenate([mesh.vertices, mesh.visual.uv, mesh.vertex_normals], axis=1)[mesh.faces.ravel()]
    assert {tuple(row) for row in np.round(rows, 5) + 0.0} == source_corners(CUBE + faces_of("groups"))
    colored = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 0.5\nf -3 -2 -1\n"
    (tmp_path / "c.obj").write_text(colored)
    found = load_mesh_scene(tmp_path / "c.obj", process=False).to_mesh().visual.vertex_colors
    np.testing.assert_array_equal(found[:, :3], [[255, 0, 0], [0, 255, 0], [0, 0, 128]])
    (tmp_path / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/2 3/3\n")
    assert len(load_mesh_scene(tmp_path / "bare.obj").to_mesh().faces) == 1
    with pytest.raises(InputError, match=r"mesh\.uvs is missing"):
        load_mesh_asset(tmp_path / "bare.obj")
    (tmp_path / "far.obj").write_text(SQUARE + "f 1 2 999999999\n")
    with pytest.raises(InputError, match=r"far\.obj: mesh\.faces has an index out of range in line 10"):
        load_mesh_scene(tmp_path / "far.obj")


@pytest.mark.slow
def test_a_million_faces_take_seconds(tmp_path: Path) -> None:
    """6 s of processor time, measured on 2026-12-01 beside other programs."""
    side = 710
    index = np.arange(side * side).reshape(side, side) + 1
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.repeat(np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), 3, axis=1)
    points = np.random.default_rng(0).random((side * side, 3))
    with open(tmp_path / "a.obj", "w") as file:
        file.writelines(f"v {x:.6f} {y:.6f} {z:.6f}\nvt {x:.6f} {y:.6f}\nvn 0 0 1\n" for x, y, z in points.tolist())
        file.writelines("f {}/{}/{} {}/{}/{} {}/{}/{}\n".format(*row) for row in faces.tolist())
    before = time.process_time()
    mesh = load_mesh_asset(tmp_path / "a.obj").mesh
    assert time.process_time() - before < 60
    assert len(mesh.faces) == len(faces) > 1_000_000
    np.testing.assert_array_equal(mesh.faces, (faces[:, ::3] - 1))
