"""Contracts of capture readers: a known capture, written in their format by the plugin's own `testing` function."""

from __future__ import annotations

import contextlib
import os
import pickle
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import numpy as np

from hir_core.capture import Capture, Pixels, View
from hir_core.errors import HirError
from hir_core.plugins.interfaces import CaptureReader
from hir_core.plugins.registration import a_value
from hir_core.testing.captures import TinyCapture, similarity_between, surface_points, tiny_capture
from hir_core.testing.contract import Subject, contract, require
from hir_core.testing.exercise import Exercise, digest
from hir_core.testing.opened_paths import opened_paths

FOLDERS_OF_PICTURES = 3
"""A format may name pictures relative to its file, or to a folder below, or to one below that."""
NUMBERS = 40
"""At most so many numbers of a file are damaged, one at a time."""
NUMBER = re.compile(r"(?<![\w.-])-?\d+(\.\d*)?([eE][+-]?\d+)?(?![\w.])")
IMAGES = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff")


def _written(subject: Subject) -> tuple[TinyCapture, Path]:
    """The truth, and where the plugin's `testing` function wrote it in the reader's format."""
    require(
        subject.testing is not None,
        "testing names no function; write one that writes a capture in the format: "
        "function(capture, folder) -> the path to read",
    )
    assert subject.testing is not None
    if "written" not in subject.memory:
        truth, folder = tiny_capture(subject.folder(), views=6, size=48), subject.folder()
        subject.memory["written"] = truth, Path(subject.testing(truth.capture, folder)), folder
    truth, path, _ = subject.memory["written"]
    return truth, path


def exercise(subject: Subject, device: str) -> Exercise:
    """Cameras and pixels of the written capture; the input is the folder."""
    del device
    _, path = _written(subject)

    def run() -> dict[str, np.ndarray]:
        capture = subject.create().read(path)
        cameras = [v.camera.world_to_camera for v in capture.views if v.camera is not None]
        pixels = [v.pixels().color_linear for v in capture.views]
        return {"cameras": np.array(cameras), "pixels": np.array(pixels)}

    return Exercise({"folder": path}, run)


@contract("capture_reader")
def reader_has_no_options(subject: Subject) -> None:
    """The options of a reader have no field: a capture is recognised and read before there are settings, and again
    without them, so that no setting reaches a reader.
    """
    options = [field.name for field in fields(subject.component.config)]
    require(
        not options, f"the option {', '.join(options)} can never be set; use NoOptions, and read it from the capture"
    )


@contract("capture_reader")
def knows_its_own_format(subject: Subject) -> None:
    """`matches` says yes to its own format and no to an empty folder, a folder of text, a path that is not there, and,
    unless it declares `without_cameras`, to a folder of photographs alone and to captures of the built-in formats that
    have cameras. `splits` names "train", and each other split that it names has other views; a split that is not there
    is a `CaptureError`.
    """
    _, path = _written(subject)
    reader: CaptureReader = subject.create()
    require(reader.matches(path), "matches() says no to a capture of its own format")
    strange = subject.folder()
    (strange / "notes.txt").write_text("nothing to see\n", encoding="utf-8")
    foreign = {
        "an empty folder": subject.folder(),
        "a folder of text": strange,
        "a path that is not there": strange / "missing",
        **({} if subject.has("without_cameras") else _of_other_formats(subject)),
    }
    for name, other in foreign.items():
        try:
            answer = reader.matches(other)
        except Exception as error:
            answer = None
            require(False, f"matches() of {name} raises {type(error).__name__}: {error}")
        require(not answer, f"matches() says yes to {name}; look for the file that only this format has")
    _require_splits_of_other_views(reader, path)
    _raises(lambda: reader.read(path, "no_such_split"), "a split that is not there")


def _of_other_formats(subject: Subject) -> dict[str, Path]:
    """Folders that other readers read: photographs alone, and a capture of each built-in format with cameras."""
    truth = tiny_capture(subject.folder(), views=3, size=24)
    folders = {"a folder of photographs": truth.folder / "images", "a folder with photographs in images/": truth.folder}
    for registered in subject.plugins.components("capture_reader"):
        component = registered.component
        built_in = registered.distribution == "hir" and "without_cameras" not in component.traits
        if not built_in or component.name == subject.name or registered.missing or not component.testing:
            continue
        if subject.component.testing == component.testing:
            continue  # the same format, read by another reader
        module, _, function = component.testing.partition(":")
        folders[f"a capture of the format {component.name}"] = Path(
            getattr(import_module(module), function)(truth.capture, subject.folder())
        )
    return folders


def _require_splits_of_other_views(reader: CaptureReader, path: Path) -> None:
    splits = reader.splits(path)
    require(isinstance(splits, list) and "train" in splits, f"splits() is {splits}; it must be a list with 'train'")
    pictures = {split: {digest(view.pixels().color_linear) for view in _read(reader, path, split)} for split in splits}
    for split in splits:
        require(pictures[split], f"the split {split!r} that splits() names has no view; leave it out")
        shared = len(pictures[split] & pictures["train"]) if split != "train" else 0
        require(
            not shared,
            f"the split {split!r} has {shared} of the photographs of 'train'; read(path, {split!r}) must return other "
            "views, or splits() must leave it out",
        )


def _read(reader: CaptureReader, path: Path, split: str = "train") -> tuple[View, ...]:
    """The views of a split; `BrokenContract` where `read` returns another type."""
    capture = reader.read(path, split)
    require(isinstance(capture, Capture), f"read() returns {a_value(capture)}; return a Capture")
    require(
        isinstance(capture.views, tuple),
        f"the capture's views are {a_value(capture.views)}, which could change later; write tuple(views)",
    )
    return capture.views


@contract("capture_reader")
def cameras_are_where_they_were(subject: Subject) -> None:
    """Cameras come back: up to a similarity of the world (+Y still up, within 30°) known points land on the pixels
    where they were, to 0.05 pixel; the order and number of views is that of the names.
    """
    truth, path = _written(subject)
    capture = subject.create().read(path)
    pairs = _paired(truth, capture)
    if all(view.camera is None for view, _ in pairs):
        return  # a format without cameras: an initializer computes them
    lost = [view.name for view, _ in pairs if view.camera is None]
    require(not lost, f"the view {', '.join(lost)} has no camera, others have")
    cameras = [(view.camera, known.camera) for view, known in pairs if view.camera and known.camera]
    have = np.array([camera.center for camera, _ in cameras])
    true = np.array([known.center for _, known in cameras])
    world, left = similarity_between(true, have)
    size = float(np.cbrt(np.linalg.det(world[:3, :3])))
    require(
        left < 1e-3 * size * 3,
        f"the cameras' centres do not fit the true ones: {left / size:.3g} radii are left "
        "after the best similarity; a mirrored or wrongly converted axis leaves much",
    )
    up = world[:3, :3] @ [0.0, 1.0, 0.0] / size
    require(
        up[1] > np.cos(np.radians(30)),
        f"what was up is now {np.round(up, 2).tolist()}; +Y must be up: return capture.transformed(similarity), with "
        "the 4×4 similarity that turns the up of the format into +Y",
    )
    points = surface_points(60).positions
    moved = points @ world[:3, :3].T + world[:3, 3]
    for (view, _), (camera, known) in zip(pairs, cameras, strict=True):
        expected, _ = known.project(points)
        found, depth = camera.project(moved)
        off = float(np.abs(found - expected).max())
        require(
            off < 0.05 and depth.min() > 0,
            f"in view {view.name} a known point is {off:.3g} pixels from its place "
            "(half a pixel: another convention of pixel centres)",
        )


@contract("capture_reader")
def source_axes_are_recorded(subject: Subject) -> None:
    """`world_from_source` is a similarity: finite, no reflection, no shear."""
    _, path = _written(subject)
    transform = subject.create().read(path).world_from_source
    require(transform.shape == (4, 4) and np.isfinite(transform).all(), f"world_from_source is {transform}")
    linear = transform[:3, :3]
    scale = np.cbrt(np.linalg.det(linear))
    require(scale > 0, f"world_from_source mirrors: its determinant is {np.linalg.det(linear):.3g}")
    shear = float(np.abs(linear @ linear.T / scale**2 - np.eye(3)).max())
    require(shear < 1e-6, f"world_from_source is no similarity: it shears by {shear:.3g}")


@contract("capture_reader")
def pixels_are_linear(subject: Subject) -> None:
    """Pixels come back scene-linear (8-bit sRGB is decoded), to half a step of 8 bits; masks are the coverage where the
    format has them; `View.read` can be pickled. Colours and masks are float32; `saturated` is an array of bool
    (height, width) that is true where the photograph is clipped alone; a camera has the size of its picture.
    """
    from hir_exporters.conventions import linear_to_srgb

    truth, path = _written(subject)
    capture = subject.create().read(path)
    for view, known in _paired(truth, capture):
        pixels, true = view.pixels(), known.pixels()
        _require_types_and_sizes(view)
        require(
            pixels.color_linear.shape == true.color_linear.shape,
            f"view {view.name} is {pixels.color_linear.shape}, its picture {true.color_linear.shape}",
        )
        assert true.mask is not None
        solid = true.mask > 0.99 if pixels.mask is not None else np.ones(true.mask.shape, bool)
        off = np.abs(linear_to_srgb(pixels.color_linear) - linear_to_srgb(true.color_linear))[solid]
        require(
            float(off.max()) < 0.6 / 255,
            f"colours of view {view.name} are off by {255 * float(off.max()):.1f} steps of 8-bit sRGB",
        )
        if pixels.mask is not None:
            difference = float(np.abs(pixels.mask - true.mask).max())
            require(difference < 0.6 / 255 + 1e-6, f"the mask of view {view.name} is off by {difference:.3g}")
        pickle.dumps(view.read)


def _require_types_and_sizes(view: View) -> None:
    pixels = view.read()
    require(isinstance(pixels, Pixels), f"`View.read` of view {view.name} returns {a_value(pixels)}; return Pixels")
    height, width = pixels.color_linear.shape[:2]
    for name, values in (("colours", pixels.color_linear), ("mask", pixels.mask)):
        if values is not None:
            require(
                values.dtype == np.float32,
                f"the {name} of view {view.name}: {values.dtype}, not float32; write .astype(np.float32)",
            )
    saturated: object = pixels.saturated
    require(
        isinstance(saturated, np.ndarray) and saturated.dtype == bool and saturated.shape == (height, width),
        f"`saturated` of view {view.name} is {_array_or_value(saturated)}; it must be an array of bool "
        f"({height}, {width}): np.zeros(color.shape[:2], bool) where nothing is known",
    )
    share, brightest = float(np.mean(pixels.saturated)), float(pixels.color_linear.max())
    require(
        share == 0 or brightest > 0.9,
        f"`saturated` of view {view.name} is true for {100 * share:.0f} % of a photograph whose brightest value is "
        f"{brightest:.2f}; it is true where the sensor clipped",
    )
    camera = view.camera
    require(
        camera is None or (camera.width, camera.height) == (width, height),
        f"the camera of view {view.name} is for {camera.width if camera else 0} × {camera.height if camera else 0} "
        f"pixels, its picture has {width} × {height}; Camera(intrinsics, world_to_camera, width, height)",
    )


def _array_or_value(value: object) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else a_value(value)


@contract("capture_reader")
def stays_in_its_folder(subject: Subject) -> None:
    """A reader opens and lists what lies in the capture, nothing beside it; a file of the capture that names a picture
    outside of it, by `../`, is a `CaptureError`.
    """
    require(subject.testing is not None, "testing names no function that writes a capture in the format")
    assert subject.testing is not None
    truth = tiny_capture(subject.folder(), views=3, size=24)
    outer = subject.folder()
    (outer / "capture").mkdir()
    path = Path(subject.testing(truth.capture, outer / "capture"))
    (outer / "beside.txt").write_text("of somebody else\n", encoding="utf-8")
    with opened_paths() as opened:
        _all_pixels(subject.create(), path)
    _require_inside(opened, outer, "")
    pictures = [f for f in sorted((outer / "capture").rglob("*")) if f.suffix.lower() in IMAGES]
    for file in sorted((outer / "capture").rglob("*")):
        if not file.is_file() or file in pictures:
            continue
        before = file.read_bytes()
        for deeper in range(FOLDERS_OF_PICTURES):
            if _names_outside(file, pictures, outer, deeper):
                with opened_paths() as opened, contextlib.suppress(HirError):
                    _all_pixels(subject.create(), path)
                _require_inside(opened, outer, f" because {file.name} names it by ../")
                file.write_bytes(before)


def _all_pixels(reader: CaptureReader, path: Path) -> None:
    for view in reader.read(path).views:
        view.pixels()


def _names_outside(file: Path, pictures: Sequence[Path], outer: Path, deeper: int) -> bool:
    """Changes names of pictures in a file to copies outside of the capture; False where it is no text or has none. The
    names lead out of a folder that lies so many levels `deeper` than the file.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    changed = text
    for picture in pictures:
        shutil.copy(picture, outer / picture.name)
        up = "../" * (len(file.parent.relative_to(outer).parts) + deeper)
        for name in (Path(os.path.relpath(picture, file.parent)).as_posix(), picture.name):
            pattern = rf"(?<![\w./-])(\./)?{re.escape(name)}(?![\w.-])"
            changed, count = re.subn(pattern, f"{up}{picture.name}", changed)
            if count:
                break
    file.write_text(changed, encoding="utf-8")
    return changed != text


def _require_inside(opened: Sequence[Path], outer: Path, why: str) -> None:
    capture = outer / "capture"
    outside = {path for path in opened if path.is_relative_to(outer) and not path.is_relative_to(capture)}
    beside = sorted("the folder that holds the capture" if path == outer else path.name for path in outside)
    require(
        not beside,
        f"it opens {', '.join(beside)}, which lies outside of the capture{why}; raise CaptureError unless "
        "(folder / name).resolve().is_relative_to(folder.resolve())",
    )


@contract("capture_reader")
def malformed_files_are_refused(subject: Subject) -> None:
    """Each file of a capture in turn cut short, emptied, filled with garbage, its numbers turned into NaN, all at once
    or one at a time, or removed: reading gives a capture or a `HirError` with a sentence, never another error and never
    numbers that are not finite.
    """
    require(subject.testing is not None, "testing names no function that writes a capture in the format")
    assert subject.testing is not None
    truth = tiny_capture(subject.folder(), views=3, size=24)
    first = subject.folder()
    files = sorted(f.relative_to(first) for f in _written_files(subject, truth.capture, first))
    described = [f for f in files if f.suffix.lower() not in IMAGES]
    pictures = [f for f in files if f.suffix.lower() in IMAGES][:1]
    for file in described + pictures:
        for how in ("cut short", "emptied", "filled with garbage", "with NaN for its numbers", "removed"):
            folder = subject.folder()
            path = Path(subject.testing(truth.capture, folder))
            _break(folder / file, how)
            _reads_or_refuses(subject.create(), path, f"{file.as_posix()} {how}")
    for file in described:
        _damage_one_number_at_a_time(subject, truth.capture, file)


def _damage_one_number_at_a_time(subject: Subject, capture: Capture, file: Path) -> None:
    """Numbers from all over a text become NaN or infinite: a reader that checks some of them alone lets one through."""
    assert subject.testing is not None
    folder = subject.folder()
    path = Path(subject.testing(capture, folder))
    try:
        text = (folder / file).read_text(encoding="utf-8")
    except (UnicodeDecodeError, FileNotFoundError):
        return
    numbers = list(NUMBER.finditer(text))
    for i in sorted({int(i) for i in np.linspace(0, len(numbers) - 1, min(len(numbers), NUMBERS))}):
        start, end = numbers[i].span()
        for damage in ("NaN", "1e999"):
            (folder / file).write_text(text[:start] + damage + text[end:], encoding="utf-8")
            line = text.count("\n", 0, start) + 1
            what = f"{damage} in the place of {text[start:end]} in line {line} of {file.as_posix()}"
            _reads_or_refuses(subject.create(), path, what)


def _written_files(subject: Subject, capture: Capture, folder: Path) -> list[Path]:
    assert subject.testing is not None
    subject.testing(capture, folder)
    return [f for f in folder.rglob("*") if f.is_file()]


def _break(file: Path, how: str) -> None:
    data = file.read_bytes()
    if how == "cut short":
        file.write_bytes(data[: len(data) // 2])
    elif how == "emptied":
        file.write_bytes(b"")
    elif how == "filled with garbage":
        file.write_bytes(np.random.default_rng(0).bytes(max(len(data), 64)))
    elif how == "removed":
        file.unlink()
    else:
        text = "".join(chr(b) if b < 128 else "?" for b in data)
        for digit in "123456789":
            text = text.replace(f" {digit}", " NaN").replace(f"[{digit}", "[NaN")
        file.write_text(text, encoding="utf-8")


def _reads_or_refuses(reader: CaptureReader, path: Path, what: str) -> None:
    try:
        if not reader.matches(path):
            return
        capture = reader.read(path)
        numbers = [_numbers_of(view) for view in capture.views]
        if capture.points is not None:
            numbers += [a for a in (capture.points.positions, capture.points.normals) if a is not None]
    except HirError as error:
        require(
            len(str(error)) > 15, f"with {what} it raises {type(error).__name__}({str(error)!r}), which says nothing"
        )
        return
    except Exception as error:
        require(False, f"with {what} it raises {type(error).__name__}: {error}")
        return
    require(
        all(np.isfinite(n).all() for n in numbers),
        f"with {what} it reads numbers that are not finite; check them by np.isfinite and raise CaptureError",
    )


def _numbers_of(view: View) -> np.ndarray:
    camera = view.camera
    numbers = [view.pixels().color_linear.ravel(), np.array([view.exposure, *view.white_balance, *view.distortion])]
    if camera is not None:
        numbers += [camera.world_to_camera.ravel(), camera.intrinsics.ravel(), np.array(camera.distortion)]
    return np.concatenate(numbers)


def _raises(call: Callable[[], object], what: str) -> None:
    try:
        call()
    except HirError:
        return
    except Exception as error:
        require(False, f"{what} raises {type(error).__name__}: {error}; a CaptureError is needed")
    require(False, f"{what} is read without an error")


def _paired(truth: TinyCapture, capture: Capture) -> list[tuple[View, View]]:
    """Views with the true ones: by name where the format keeps names, else in the order of names."""
    require(isinstance(capture, Capture), f"read() returns {a_value(capture)}; return a Capture")
    names = [view.name for view in capture.views]
    require(len(set(names)) == len(names), f"names of views repeat: {', '.join(names)}")
    require(
        len(names) == len(truth.capture.views), f"{len(truth.capture.views)} views were written, {len(names)} are read"
    )
    known = {view.name: view for view in truth.capture.views}
    if set(names) == set(known):
        return [(view, known[view.name]) for view in capture.views]
    return list(zip(sorted(capture.views, key=lambda v: v.name), truth.capture.views, strict=True))
