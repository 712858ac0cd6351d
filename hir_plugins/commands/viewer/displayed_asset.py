"""What the viewer displays: a run's asset, a scene folder or an exported file, as .glb bytes and a light."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.errors import InputError
from hir_exporters.formats import create_exporter
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.reading.asset_decoding import decode_asset
from hir_exporters.reading.file_verification import READERS, read_back
from hir_exporters.reading.gltf_json.stored_accessors import check_geometry
from hir_exporters.reading.gltf_readback import read_gltf_surface
from hir_exporters.scene_format import load_scene
from hir_exporters.textures.image_files import read_exr, read_hdr
from numpy.typing import NDArray

from hir_core.run.run_directory import refuse_links
from hir_plugins.commands.viewer.unshown_features import warn_of_unshown_features

COMPRESSIONS: Final = (
    b"EXT_meshopt_compression",
    b"KHR_draco_mesh_compression",
    b"KHR_meshopt_compression",
    b"KHR_texture_basisu",
)
"""glTF extensions whose decoders the page does not contain."""

Radiance = NDArray[np.floating]
"""A lat-long environment map (H, W, 3), linear, in world axes."""


@dataclass(frozen=True)
class DisplayedAsset:
    """A title, the bytes of a .glb without light, and the light that belongs to it."""

    title: str
    glb: bytes
    radiance: Radiance | None


def load_displayed_asset(source: Path, other_light: bool = False) -> DisplayedAsset:
    """Reads a run directory, a scene folder or a file.

    An uncompressed .glb is passed on byte for byte; every other file is converted through an independent reader. The
    light is the scene's own, or the .hdr beside the file. One warning names what a glTF has and the page does not show;
    with `other_light` the page has another light, and that in the file is not named.
    Raises `InputError` if the source cannot be displayed.
    """
    if source.is_dir():
        return _scene_folder(source)
    if not source.is_file():
        raise InputError(f"{source} does not exist; give a run directory, a scene folder or a file such as a .glb")
    beside = source.with_suffix(".hdr")
    radiance = read_hdr(beside) if beside.is_file() else None
    if source.suffix.lower() in (".glb", ".gltf"):
        check_geometry(source)
    content = source.read_bytes() if source.suffix.lower() == ".glb" else None
    if content is not None and not any(name in content for name in COMPRESSIONS):
        warn_of_unshown_features(source, with_light=other_light or radiance is not None)
        return DisplayedAsset(source.stem, content, radiance)
    if source.suffix.lower() not in READERS:
        readable = ", ".join(READERS)
        raise InputError(f"{source} cannot be displayed; supported are runs, scene folders and the formats {readable}")
    asset = decode_asset(read_back(source, untrusted=True))
    if source.suffix.lower() in (".glb", ".gltf"):
        read_gltf_surface(source, asset.mesh)  # for its warning
    environment = None if radiance is None else AssetEnvironment(radiance)
    return _as_glb(Asset(asset.mesh, asset.material, environment, name=source.stem))


def read_light(path: Path) -> Radiance:
    """A lat-long .hdr or .exr file (H, W, 3); `InputError` for other formats."""
    if path.suffix.lower() == ".exr":
        return read_exr(path)[..., :3]
    if path.suffix.lower() == ".hdr":
        return read_hdr(path)
    raise InputError(f"--light {path}: the light must be a lat-long .hdr or .exr file")


def _scene_folder(source: Path) -> DisplayedAsset:
    folder = source if (source / "scene.json").is_file() else source / "scene"
    if not (folder / "scene.json").is_file():
        raise InputError(
            f"{source} contains no finished scene; give a run directory, a scene folder or a file such as a .glb"
        )
    if folder != source:
        refuse_links(source)
    return _as_glb(load_scene(folder))


def _as_glb(asset: Asset) -> DisplayedAsset:
    radiance = None if asset.environment is None else world_radiance(asset)[0]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "asset.glb"
        create_exporter("glb").write(replace(asset, environment=None), file)
        return DisplayedAsset(asset.name, file.read_bytes(), radiance)
