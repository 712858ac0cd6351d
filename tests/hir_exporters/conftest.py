"""Assets that the exporters' tests share."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh

REPOSITORY = Path(__file__).resolve().parents[2]


def uv_sphere(rings: int = 12, segments: int = 24, wobble: float = 0.0) -> AssetMesh:
    """A UV sphere with a seam: positions repeat where u wraps, so there is one vertex for each (position, UV) pair."""
    v, u = np.meshgrid(np.linspace(0, 1, rings + 1), np.linspace(0, 1, segments + 1), indexing="ij")
    polar, azimuth = v * np.pi, u * 2 * np.pi
    # u grows to the right seen from outside, as v grows downwards: the texture is not mirrored.
    normals = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)
    normals[:, -1] = normals[:, 0]
    radius = 1 + wobble * np.sin(5 * azimuth) * np.sin(polar) ** 2
    radius[:, -1] = radius[:, 0]
    corner = np.arange((rings + 1) * (segments + 1)).reshape(rings + 1, segments + 1)
    a, b, c, d = (x.ravel() for x in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    positions = (normals * radius[..., None]).astype(np.float32).reshape(-1, 3)
    a, b, c = positions[faces].transpose(1, 0, 2)
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-7]
    used, faces = np.unique(faces, return_inverse=True)
    uvs = np.stack([u, v], -1).reshape(-1, 2)
    return AssetMesh(positions[used], normals.reshape(-1, 3)[used], uvs[used], faces.reshape(-1, 3))


def smooth_texture(size: int, channels: int, low: float, high: float, seed: int = 0) -> np.ndarray:
    """(size, size, channels) of slow waves between `low` and `high`."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size] / size * 2 * np.pi
    waves = [np.sin(rng.integers(1, 4) * x + rng.integers(1, 4) * y + rng.uniform(0, 6)) for _ in range(channels)]
    return (low + (high - low) * (np.stack(waves, -1) + 1) / 2).astype(np.float32)


def normal_map(size: int, seed: int = 3) -> np.ndarray:
    """(size, size, 3) unit vectors in tangent space, up to about 30 degrees off."""
    slope = smooth_texture(size, 2, -0.5, 0.5, seed)
    normal = np.concatenate([slope, np.ones((size, size, 1), np.float32)], -1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def axis_map(height: int = 32) -> np.ndarray:
    """Lat-long radiance (H, 2H, 3) with +X red, -X cyan, +Y green, -Y magenta, +Z blue, -Z yellow."""
    from hir_exporters.conventions import latlong_directions

    directions = latlong_directions(height, 2 * height)
    axis = np.abs(directions).argmax(-1)
    positive = np.take_along_axis(directions, axis[..., None], -1)[..., 0] > 0
    colors = np.eye(3)[axis]
    return np.where(positive[..., None], colors, 1 - colors).astype(np.float32)


@pytest.fixture
def textured_asset() -> Asset:
    """A dielectric sphere with all four maps, in a six-colour light."""
    material = AssetMaterial(
        "dielectric",
        diffuse_albedo=smooth_texture(32, 3, 0.1, 0.8),
        specular_albedo=smooth_texture(32, 3, 0.02, 0.08, 1),
        roughness=smooth_texture(32, 1, 0.05, 0.5, 2)[..., 0],
        normal=normal_map(32),
        observed=np.ones((32, 32), bool),
    )
    return Asset(uv_sphere(), material, AssetEnvironment(axis_map()), {"source": "test"}, "sphere")


@pytest.fixture
def constant_asset() -> Asset:
    """A grey `paper` sphere without textures or light."""
    return Asset(uv_sphere(), AssetMaterial("paper", [0.5, 0.4, 0.3], [0.2, 0.2, 0.2], 0.25), name="ball")


@pytest.fixture(scope="session")
def make_sphere() -> Callable[..., AssetMesh]:
    """`uv_sphere`, for tests that need another size."""
    return uv_sphere


@pytest.fixture(scope="session")
def make_texture() -> Callable[..., np.ndarray]:
    """`smooth_texture`, for tests that build materials."""
    return smooth_texture


@pytest.fixture(scope="session")
def six_colors() -> np.ndarray:
    """`axis_map` at 64 x 128."""
    return axis_map(64)


@pytest.fixture(scope="session")
def node_tools() -> Path:
    """The folder of the node programs that check our files, with their packages installed."""
    tools = REPOSITORY / "tools"
    programs = ("gltf-validator", "mikktspace")
    if shutil.which("node") is None or not all((tools / "node_modules" / name).is_dir() for name in programs):
        pytest.skip(f"node, {' or '.join(programs)} is not installed: run tools/setup.sh test")
    return tools
