"""A scan with its own texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from hir_exporters.conventions import srgb_to_linear

from hir_core.rendering.textured_scan import linear_reduced, textured_scan
from hir_core.scene import Mesh, Scene, Topology
from hir_core.scene.scan import Scan, save_scan
from hir_core.scene.scene_store import save_stage_scene

CODES = np.random.default_rng(0).integers(0, 256, (9, 6, 3)).astype(np.uint8)


def test_a_texture_is_decoded_once_and_reduced_in_linear_light() -> None:
    linear = srgb_to_linear(CODES / 255)
    np.testing.assert_allclose(linear_reduced(CODES, 9), linear, rtol=1e-6)
    reduced = linear_reduced(CODES, 4)
    assert reduced.shape == (3, 2, 3) and reduced.dtype == np.float32
    np.testing.assert_allclose(reduced, linear.reshape(3, 3, 2, 3, 3).mean(axis=(1, 3)), rtol=1e-6)
    assert linear_reduced(np.zeros((1, 9000, 3), np.uint8), 4096).shape == (1, 9000, 3), "one row cannot be halved"


def test_the_scan_of_a_stage(tmp_path: Path) -> None:
    uvs = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    faces = torch.tensor([[0, 1, 2]])
    mesh = Mesh(torch.eye(3), Topology(faces, faces), uvs)
    save_stage_scene(Scene(mesh), tmp_path / "scene")
    assert textured_scan(tmp_path) is None
    save_scan(Scan("a.obj"), tmp_path)
    assert textured_scan(tmp_path) is None
    save_scan(Scan("a.obj", CODES), tmp_path)
    scene = textured_scan(tmp_path)
    assert scene is not None and scene.material is not None and scene.environment is None
    torch.testing.assert_close(scene.mesh.uvs, uvs)
    np.testing.assert_allclose(scene.material.diffuse_albedo, srgb_to_linear(CODES / 255), rtol=1e-6)
