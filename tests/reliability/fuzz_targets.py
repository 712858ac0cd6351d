"""Every reader of untrusted files, as a function of bytes. A reader may refuse them with `HirError` only.

A target has seeds, whole files that it reads, which fuzzers change. `tests/reliability/test_fuzz.py` changes them with
hypothesis, a few hundred times; `tools/fuzz.py` for minutes, with atheris where it is installed.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
from hir_exporters.errors import HirError
from hir_exporters.files.native_output import suppress_native_output
from hir_exporters.textures.image_files import encode_png, write_exr, write_hdr

from hir_core.plugins.manager import PluginManager
from tests.reliability import seeds

_REFUSED = 3
"""Exit code of a fork that refused its file with a `HirError`."""

PLACE = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(tempfile.gettempdir())
"""Files are written millions of times, so in memory where the system has such a folder."""


@dataclass(frozen=True)
class Target:
    """One reader of one file."""

    name: str
    file: str
    """Name of the file, in a folder that `seed_folder` filled."""
    read: Callable[[Path], object]
    """Reads the folder."""
    seed_folder: Callable[[Path], None]
    """Makes a folder that can be read."""
    slow: bool = False
    """It takes more than a few milliseconds, so quick tests use fewer examples."""

    def seeds(self) -> list[bytes]:
        """Valid files."""
        return [(folder_of(self) / self.file).read_bytes(), *seeds.corpus(self.name)]

    def __call__(self, data: bytes) -> bool:
        """Writes the file and reads the folder: True if it was read, False if it was refused with `HirError`."""
        folder = folder_of(self)
        original = (folder / self.file).read_bytes()
        (folder / self.file).write_bytes(data)
        try:
            self.read(folder)
        except HirError as error:
            assert _one_sentence(error), "an error is one sentence"
            return False
        finally:
            (folder / self.file).write_bytes(original)
        return True


def _one_sentence(error: HirError) -> bool:
    return bool(str(error).strip()) and "\n" not in str(error).strip()


@cache
def folder_of(target: Target) -> Path:
    """A folder of the target, made once per process."""
    folder = Path(tempfile.mkdtemp(prefix=f"hir-fuzz-{target.name}-", dir=PLACE))
    target.seed_folder(folder)
    return folder


@cache
def _plugins() -> PluginManager:
    return PluginManager.discover()


def remove_folders() -> None:
    """Removes what `folder_of` made."""
    for target in TARGETS:
        shutil.rmtree(folder_of(target), ignore_errors=True)
    folder_of.cache_clear()


def _picture(name: str, read: Callable[[Path], object]) -> Target:
    def fill(folder: Path) -> None:
        image = np.random.default_rng(0).random((6, 9, 3)).astype(np.float32)
        path = folder / name
        if path.suffix == ".exr":
            write_exr(path, image)
        elif path.suffix == ".hdr":
            write_hdr(path, image)
        elif path.suffix == ".png":
            path.write_bytes(encode_png(image))
        else:
            from PIL import Image

            Image.fromarray((image * 255).astype(np.uint8)).save(path)

    return Target(name.replace(".", "_"), name, lambda folder: read(folder / name), fill)


def _ldr(path: Path) -> object:
    from hir_exporters.textures.image_files import read_ldr

    return read_ldr(path, max_pixels=1 << 20)


def _hdr(path: Path) -> object:
    from hir_exporters.textures.image_files import read_hdr

    return read_hdr(path, max_pixels=1 << 20)


def _photo(path: Path) -> object:
    from hir_core.capture.exif import camera_record

    return camera_record(path), _ldr(path)


def _scene(folder: Path) -> object:
    from hir_exporters.scene_format import load_scene

    return load_scene(folder)


def _run(folder: Path) -> object:
    from hir_core.plugins.manager import PluginManager
    from hir_core.report import refresh_page
    from hir_core.run.run_directory import open_run

    run = open_run(folder)
    run.read_run()
    return refresh_page(run, PluginManager.discover())


def _record(folder: Path) -> object:
    from hir_core.run.run_directory import RunDirectory

    return RunDirectory(folder).record("geometry")


def _timings(folder: Path) -> object:
    from hir_core.plugins.manager import PluginManager
    from hir_core.report import refresh_page
    from hir_core.run.run_directory import open_run

    return refresh_page(open_run(folder), PluginManager.discover())


def _cameras(folder: Path) -> object:
    from hir_core.run.capture_store import read_cameras

    return read_cameras(folder / "cameras.json")


def _toml(folder: Path) -> object:
    from hir_core.config import load_config

    return load_config(_plugins(), file=folder / "settings.toml")


def _assignment(folder: Path) -> object:
    from hir_core.config import load_config

    text = (folder / "assignment").read_bytes().decode("utf-8", "replace")
    return load_config(_plugins(), assignments=text.splitlines())


def _stage_scene(folder: Path) -> object:
    from hir_core.scene.scene_store import load_stage_scene

    return load_stage_scene(folder)


def _checkpoint(folder: Path) -> object:
    import torch

    from hir_core.optimization.checkpoints import load_checkpoint

    return load_checkpoint(folder / "state.npz", torch.optim.Adam([torch.zeros(3, requires_grad=True)]))


def _capture(folder: Path) -> object:
    """Cameras, masks, the first picture and its depth of whatever reader knows the folder."""
    from hir_core.intake.reader_lookup import read_capture

    capture = read_capture(folder, "train", _plugins())
    return [(view.pixels(), view.measured_depth()) for view in capture.views[:1]]


def _restored(folder: Path) -> object:
    from hir_core.run.capture_store import restore_capture

    return [view.pixels() for view in restore_capture(seeds.two_views(folder), folder).views]


def _curves(folder: Path) -> object:
    from hir_core.report.convergence import curves, history
    from hir_core.run.run_directory import open_run

    directory = open_run(folder)
    return curves(directory), history(directory, directory.read_run(), directory.read_timings())


def _marks(folder: Path) -> object:
    from hir_plugins.initializers.sfm.metric_scale import read_marks

    return read_marks(folder / "bar.txt")


def _bench(folder: Path) -> object:
    from hir_plugins.commands.bench.results import comparison, markdown_tables
    from hir_plugins.commands.bench.results.bench_result import Result

    result = Result.read(folder / "geometry.json")
    return markdown_tables.result_markdown(result), comparison.comparison_table(result, result)


def _batch(folder: Path) -> object:
    from hir_plugins.commands.batch.scheduling.manifest import Manifest
    from hir_plugins.commands.batch.storage.storage_path import StoragePath
    from hir_plugins.commands.batch.summary.summary_page import render_page

    captures = Manifest(StoragePath(str(folder / "batch.json")), {}).read()
    return render_page("it", captures, list(captures), {}, "today")


def _lease(folder: Path) -> object:
    from hir_plugins.commands.batch.storage.lease import is_expired, read_lease
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    return is_expired(read_lease(StoragePath(str(folder / "lease.json"))), 0.0)


def _mesh(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from hir_plugins.initializers.existing_mesh.mesh_loading import load_mesh

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return load_mesh(folder / name)

    return read


def _asset(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from hir_exporters.reading.mesh_import import load_mesh_asset

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about what is left out
            return load_mesh_asset(folder / name)

    return read


def _usd(name: str) -> Callable[[Path], object]:
    """OpenUSD in a fork, which it may end: what `read_untrusted_usd` does, without Python's half second of start."""

    def read(folder: Path) -> object:
        from hir_exporters.reading import mesh_import
        from hir_exporters.reading.usd_reading.usd_readback import read_usd
        from pxr import Usd, UsdGeom, UsdShade  # noqa: F401 # once, not in each fork

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns of forks beside threads
            child = os.fork()
        if child == 0:
            code = 1
            warnings.simplefilter("ignore", UserWarning)  # of what an import leaves out
            try:
                with suppress_native_output(), mock.patch.object(mesh_import, "read_untrusted_usd", read_usd):
                    mesh_import.load_mesh_asset(folder / name)
                code = 0
            except HirError as error:
                code = _REFUSED if _one_sentence(error) else 1
                (folder / "why.txt").write_text(f"no single sentence: {error}")
            except BaseException:
                (folder / "why.txt").write_text(traceback.format_exc())
            finally:
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert code <= 0 or code == _REFUSED, (folder / "why.txt").read_text()
        if code:
            raise HirError("refused, or OpenUSD's end")
        return None

    return read


TARGETS = [
    *(_picture(f"picture.{kind}", _ldr) for kind in ("png", "jpg", "tif", "webp", "bmp")),
    _picture("picture.hdr", _hdr),
    _picture("picture.exr", _hdr),
    _picture("photo.jpg", _photo),
    Target("scene_json", "scene.json", _scene, seeds.scene),
    Target("scene_ply", "mesh.ply", _scene, seeds.scene),
    Target("scene_exr", "diffuse_albedo.exr", _scene, seeds.scene),
    Target("run_json", "run.json", _run, seeds.run),
    Target("timings_json", "timings.json", _timings, seeds.run),
    Target("stage_json", "stages/2-geometry/stage.json", _record, seeds.run),
    Target("cameras_json", "cameras.json", _cameras, seeds.cameras),
    Target("settings_toml", "settings.toml", _toml, seeds.settings),
    Target("assignments", "assignment", _assignment, seeds.settings),
    Target("stage_arrays", "arrays.npz", _stage_scene, seeds.stage_scene),
    Target("stage_scene", "scene.json", _stage_scene, seeds.stage_scene),
    Target("checkpoint", "state.npz", _checkpoint, seeds.checkpoint),
    Target("stage_capture", "capture.json", _restored, seeds.stage_capture),
    Target("stage_masks", "capture.npz", _restored, seeds.stage_capture),
    Target("curves", "stages/4-reflectance/curves.npz", _curves, seeds.run),
    Target("scale_bar", "bar.txt", _marks, seeds.scale_bar),
    Target("bench_json", "geometry.json", _bench, seeds.bench),
    Target("batch_json", "batch.json", _batch, seeds.batch),
    Target("batch_lease", "lease.json", _lease, seeds.batch),
    Target("transforms_json", "transforms_train.json", _capture, seeds.transforms),
    Target("takes_toml", "takes.toml", _capture, seeds.takes),
    Target("colmap_text", "sparse/0/images.txt", _capture, seeds.colmap_text),
    Target("colmap_cameras", "sparse/0/cameras.txt", _capture, seeds.colmap_text),
    Target("colmap_points", "sparse/0/points3D.txt", _capture, seeds.colmap_text),
    Target("colmap_images_bin", "sparse/0/images.bin", _capture, seeds.colmap_binary),
    Target("colmap_cameras_bin", "sparse/0/cameras.bin", _capture, seeds.colmap_binary),
    Target("colmap_points_bin", "sparse/0/points3D.bin", _capture, seeds.colmap_binary),
    Target("idr_cameras", "cameras.npz", _capture, seeds.idr),
    Target("llff_poses", "poses_bounds.npy", _capture, seeds.llff),
    Target("middlebury", "temple_par.txt", _capture, seeds.middlebury),
    Target("blended_mvs", "cams/00000000_cam.txt", _capture, seeds.blended_mvs),
    Target("metashape", "cameras.xml", _capture, seeds.scan("metashape")),
    Target("reality_capture", "0.xmp", _capture, seeds.scan("reality_capture")),
    Target("meshroom", "cameras.sfm", _capture, seeds.scan("meshroom")),
    Target("open_mvg", "sfm_data.json", _capture, seeds.scan("open_mvg")),
    Target("bundler", "bundle.out", _capture, seeds.scan("bundler")),
    Target("polycam", "keyframes/corrected_cameras/0.json", _capture, seeds.scan("polycam")),
    Target("record3d", "recording.r3d", _capture, seeds.scan("record3d")),
    Target("record3d_metadata", "metadata", _capture, seeds.record3d_unpacked),
    Target("record3d_depth", "rgbd/0.depth", _capture, seeds.record3d_unpacked),
    Target("video", "clip.mp4", _capture, seeds.video, slow=True),
    *(Target(f"mesh_{kind}", f"mesh.{kind}", _mesh(f"mesh.{kind}"), seeds.mesh) for kind in seeds.MESHES),
    *(Target(f"asset_{kind}", f"mesh.{kind}", _asset(f"mesh.{kind}"), seeds.mesh) for kind in seeds.ASSETS),
    Target("asset_usda", "mesh.usda", _usd("mesh.usda"), seeds.usd, slow=True),
    Target("asset_usdz", "mesh.usdz", _usd("mesh.usdz"), seeds.usd, slow=True),
]


def as_json(text: object) -> bytes:
    """A document as bytes."""
    return json.dumps(text).encode()
