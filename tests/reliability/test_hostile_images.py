"""Images of other formats than ours start no other program; large ones are refused by their header, in one sentence."""

from __future__ import annotations

import os
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import HirError
from hir_exporters.textures.image_files import read_ldr
from hir_exporters.textures.pillow_images import open_image

EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 16 16
%%EndComments
0 0 16 16 rectfill
showpage
"""


@pytest.fixture
def ghostscript(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program `gs` that leaves a file when somebody starts it."""
    from PIL import EpsImagePlugin

    folder, started = tmp_path / "programs", tmp_path / "started"
    folder.mkdir()
    (folder / "gs").write_text(f"#!/bin/sh\ntouch '{started}'\nexit 1\n")
    (folder / "gs").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    return started


def header(width: int, height: int) -> bytes:
    """A PNG that states a size and has few pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    size = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(b"\0" * 64))


def test_pillow_alone_would_start_ghostscript(ghostscript: Path, tmp_path: Path) -> None:
    """The danger exists: without this, the tests below could not fail."""
    from PIL import Image

    (tmp_path / "003.png").write_bytes(EPS)
    with pytest.raises((OSError, subprocess.SubprocessError)), Image.open(tmp_path / "003.png") as image:
        image.load()
    assert ghostscript.exists()


def test_a_postscript_file_named_png_starts_no_program(ghostscript: Path, tmp_path: Path) -> None:
    from hir_core.capture.exif import camera_record, gps_position
    from hir_core.report.embedded_pictures import picture_uri
    from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size, read_encoded

    path = tmp_path / "003.png"
    path.write_bytes(EPS)
    for read in (read_ldr, read_encoded, photo_size, picture_uri, open_image):
        with pytest.raises(HirError, match=r"003\.png") as found:
            read(path)
        assert "\n" not in str(found.value)
    camera_record(path)
    assert gps_position(path) is None
    assert not ghostscript.exists()


def test_a_postscript_texture_starts_no_program(ghostscript: Path, tmp_path: Path) -> None:
    import base64
    import json

    from hir_exporters.reading.mesh_import import load_mesh_asset

    from hir_plugins.initializers.existing_mesh.mesh_loading import load_mesh
    from tests.reliability.test_hostile_files import triangle_gltf

    (tmp_path / "t.png").write_bytes(EPS)
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd t.png\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile t.png\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float s\nproperty float t\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 0 0\n0 1 0 0 0\n3 0 1 2\n"
    )
    document = triangle_gltf(
        images=[{"uri": "data:image/png;base64," + base64.b64encode(EPS).decode()}],
        textures=[{"source": 0}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    )
    document["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}]
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    for name in ("a.obj", "a.gltf"):
        for read in (load_mesh, load_mesh_asset):
            with pytest.raises(HirError, match="not an image that can be read"):
                read(tmp_path / name)
    load_mesh(tmp_path / "a.ply")
    assert not ghostscript.exists()


@pytest.mark.parametrize("size", [(60_000, 60_000), (20_000, 8_000)])
def test_an_image_that_is_too_large_is_one_sentence(
    size: tuple[int, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hir_core.cli.app import main

    (tmp_path / "images").mkdir()
    for name in ("a.png", "b.png", "c.png"):
        (tmp_path / "images" / name).write_bytes(header(*size))
    for read in (read_ldr, open_image):
        with pytest.raises(HirError, match=r"a\.png .*100000000 pixels"):
            read(tmp_path / "images" / "a.png")
    with pytest.raises(SystemExit) as ended:
        main(["check", str(tmp_path / "images")])
    assert ended.value.code == 2
    assert "pixels" in capsys.readouterr().err


def test_a_pipe_as_image_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    for read in (read_ldr, open_image):
        with pytest.raises(HirError, match="not a regular file"):
            read(tmp_path / "a.png")


def test_all_formats_of_photographs_still_open(tmp_path: Path) -> None:
    from PIL import Image

    pixels = Image.fromarray(np.full((4, 5, 3), 90, np.uint8))
    for suffix in ("png", "jpg", "tif", "webp", "bmp"):
        pixels.save(tmp_path / f"a.{suffix}")
        assert read_ldr(tmp_path / f"a.{suffix}").shape == (4, 5, 3)
    pixels.save(tmp_path / "phone.jpg", format="MPO", save_all=True, append_images=[pixels])
    assert read_ldr(tmp_path / "phone.jpg").shape == (4, 5, 3)
