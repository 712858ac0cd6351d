"""`hir light-probe` on photographs of a mirror ball that are computed here, ray by ray."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from hir_exporters.textures.image_files import read_hdr
from numpy.typing import NDArray
from PIL import Image

from hir_core.capture import Camera
from hir_core.cli.app import cli
from hir_core.errors import HirError
from hir_plugins.commands.light_probe.grey_ball import _regions
from hir_plugins.commands.light_probe.mirror_ball import reflecting_pixels
from hir_plugins.commands.light_probe.sphere_fit import Sphere, fit_sphere
from tests.fixtures.silhouette_captures import look_at

CENTER, RADIUS, SIDE, FOCAL, REFLECTANCE = np.array([0.3, -0.2, 0.1]), 0.5, 160, 220.0, 0.6
EYES = ((0.2, 0.4, 2.6), (2.2, 0.1, -1.2), (-2.0, 0.9, -0.9))
EXIF, EXPOSURE_TIME, F_NUMBER, ISO = 0x8769, 0x829A, 0x829D, 0x8827
"""Numbers of the EXIF tags."""

Rows = NDArray[np.float64]


def sky(directions: Rows) -> Rows:
    """Smooth radiance (N, 3), that differs in all directions."""
    frequencies = np.array([[2.0, 1.0, 0.5], [0.5, 2.0, 1.0], [1.0, 0.5, 2.0]])
    return 0.4 + 0.25 * np.sin(directions @ frequencies.T + [0.0, 1.0, 2.0])


def with_sun(directions: Rows) -> Rows:
    """The sky and a lamp that is 30 times as bright."""
    toward = np.array([0.6, 0.64, 0.48])
    return sky(directions) + 12.0 * np.exp((directions @ toward - 1) / 0.02)[:, None]


@dataclass(frozen=True)
class Photograph:
    """A linear picture (S, S, 3) of the ball and its mask (S, S)."""

    camera: Camera
    color: Rows
    mask: Rows


def photograph(eye: Sequence[float], light: Callable[[Rows], Rows], squash: float = 1.0) -> Photograph:
    """By intersection of four rays a pixel with the ball, or with an ellipsoid whose height is `squash` times that."""
    camera = look_at(np.array(eye), CENTER, FOCAL, SIDE, SIDE)
    fine = (np.arange(2 * SIDE) + 0.5) / 2
    pixels = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    origins, directions = camera.rays(pixels)
    scale = np.array([1, 1 / squash, 1])
    start, along = (origins - CENTER) * scale, directions * scale
    a, b, c = (along**2).sum(1), (start * along).sum(1), (start**2).sum(1) - RADIUS**2
    root = b**2 - a * c
    hit = root > 0
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    normal = (start + t[:, None] * along) * scale
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mirrored = directions - 2 * (directions * normal).sum(1, keepdims=True) * normal
    color = np.where(hit[:, None], REFLECTANCE * light(mirrored), 0)
    blocks = color.reshape(SIDE, 2, SIDE, 2, 3).mean(axis=(1, 3))
    mask = hit.astype(np.float64).reshape(SIDE, 2, SIDE, 2).mean(axis=(1, 3))
    return Photograph(camera, blocks / np.maximum(mask, 1e-9)[..., None], mask)


def write(folder: Path, photographs: Sequence[Photograph], exposures: Sequence[float] = ()) -> Path:
    """As a transforms file with 8-bit sRGB pictures; exposures as EXIF data."""
    folder.mkdir()
    frames = []
    for number, each in enumerate(photographs):
        exposure = exposures[number] if exposures else 1.0
        linear = np.clip(each.color * exposure, 0, 1)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        picture = np.dstack([encoded, each.mask])
        exif = Image.Exif()
        if exposures:
            exif[EXIF] = {EXPOSURE_TIME: exposure / 100, F_NUMBER: 4.0, ISO: 100}
        name = f"{number}.png"
        Image.fromarray(np.round(picture * 255).astype(np.uint8)).save(folder / name, exif=exif)
        pose = np.linalg.inv(each.camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    document = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": SIDE / 2, "cy": SIDE / 2, "w": SIDE, "h": SIDE, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def probe(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["light-probe", *map(str, words)])
    said = " ".join((result.output + (result.stderr if result.stderr_bytes else "")).split())
    if isinstance(result.exception, HirError):
        return 2, str(result.exception)
    return result.exit_code, said


def relative_error(found: NDArray[np.float32], light: Callable[[Rows], Rows]) -> Rows:
    """Of each texel (H, W), over channels; rows of the file are directions of the capture's axes."""
    truth = light(latlong_directions(*found.shape[:2]).reshape(-1, 3)).reshape(found.shape)
    return np.asarray((np.abs(found - truth) / truth).max(axis=-1), np.float64)


def test_the_light_of_a_ball_is_the_true_one(tmp_path: Path) -> None:
    photos = write(tmp_path / "ball", [photograph(eye, sky) for eye in EYES])
    code, said = probe(photos, "-o", tmp_path / "light.hdr", "--rows", 32)
    assert code == 0 and "3 photographs" in said and " 0.0% of the directions were not seen" in said
    error = relative_error(read_hdr(tmp_path / "light.hdr"), sky)
    assert np.median(error) < 0.01 and np.quantile(error, 0.99) < 0.04


def test_exposures_that_differ_measure_a_lamp(tmp_path: Path) -> None:
    """A lamp that the long exposures clip; its energy is that of the short ones."""
    several = [photograph(eye, with_sun) for eye in EYES for _ in range(2)]
    exposures = [1.0, 1 / 32] * 3
    photos = write(tmp_path / "ball", several, exposures)
    code, said = probe(photos, "-o", tmp_path / "light.exr", "--rows", 32)
    assert code == 0 and "are clipped in all" not in said
    found = read_hdr(tmp_path / "light.exr") / np.exp(np.mean(np.log(exposures)))
    solid = latlong_solid_angles(32, 64)[..., None]
    truth = with_sun(latlong_directions(256, 512).reshape(-1, 3)).reshape(256, 512, 3)
    np.testing.assert_allclose(
        (found * solid).sum((0, 1)), (truth * latlong_solid_angles(256, 512)[..., None]).sum((0, 1)), rtol=0.01
    )
    long_alone = write(tmp_path / "long", several[::2])
    code, said = probe(long_alone, "-o", tmp_path / "dark.exr", "--rows", 32)
    assert code == 0 and "of the directions are clipped in all photographs" in said
    assert read_hdr(tmp_path / "dark.exr").max() < 0.2 * found.max()


def test_the_light_has_the_brightness_of_the_objects_photographs(tmp_path: Path) -> None:
    """The object was exposed four times as long: its linear values are four times as large under this light."""
    photographs = [photograph(eye, sky) for eye in EYES]
    ball = write(tmp_path / "ball", photographs, [1.0] * 3)
    thing = write(tmp_path / "object", photographs, [4.0] * 3)
    for name, words in (("own", ()), ("object", ("--object", thing))):
        code, said = probe(ball, "-o", tmp_path / f"{name}.exr", "--rows", 16, *words)
        assert code == 0 and "count as exposed like" not in said
    own, beside = read_hdr(tmp_path / "own.exr"), read_hdr(tmp_path / "object.exr")
    np.testing.assert_allclose(beside, 4 * own, rtol=1e-4)
    unknown = write(tmp_path / "unknown", photographs)
    code, said = probe(ball, "-o", tmp_path / "unknown.exr", "--object", unknown)
    assert code == 0 and "unknown records no exposures, so its photographs count as exposed like those of" in said


def matt(light: Callable[[Rows], Rows], reflectance: float = 0.5) -> Callable[[Rows], Rows]:
    """Radiance (N, 3) of a matt ball by its normals (N, 3), by summation over directions."""
    directions = latlong_directions(128, 256).reshape(-1, 3)
    arriving = light(directions) * np.repeat(latlong_solid_angles(128, 256), 256, axis=1).reshape(-1, 1)

    def radiance(normals: Rows) -> Rows:
        parts = np.array_split(normals, max(1, len(normals) // 2000))
        return reflectance / np.pi * np.concatenate([np.maximum(n @ directions.T, 0) @ arriving for n in parts])

    return radiance


def matt_photograph(eye: Sequence[float], light: Callable[[Rows], Rows]) -> Photograph:
    """As `photograph`, of a matt ball: four rays a pixel give the mask, one the colour."""
    outline = photograph(eye, sky)
    camera = outline.camera
    grid = np.arange(SIDE) + 0.5
    pixels = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    origins, rays = camera.rays(pixels)
    b = ((origins - CENTER) * rays).sum(1)
    root = b**2 - ((origins - CENTER) ** 2).sum(1) + RADIUS**2
    hit = root > 0
    normal = (origins + (-b - np.sqrt(np.maximum(root, 0)))[:, None] * rays - CENTER) / RADIUS
    color = np.zeros((SIDE * SIDE, 3))
    color[hit] = matt(light)(normal[hit])
    return Photograph(camera, color.reshape(SIDE, SIDE, 3), outline.mask)


@pytest.mark.slow
def test_a_grey_ball_gives_clipped_lamps_their_brightness(tmp_path: Path) -> None:
    mirror = write(tmp_path / "mirror", [photograph(eye, with_sun) for eye in EYES])
    grey = write(tmp_path / "grey", [matt_photograph(eye, with_sun) for eye in EYES[:2]])
    words = ("--rows", 32, "--grey-ball", grey, "--grey-reflectance", "0.5")
    assert probe(mirror, "-o", tmp_path / "dark.exr", "--rows", 32)[0] == 0
    code, said = probe(mirror, "-o", tmp_path / "light.exr", *words)
    assert code == 0 and "are clipped in all" not in said and "that of the grey ball differ by" in said
    truth = with_sun(latlong_directions(256, 512).reshape(-1, 3)).reshape(256, 512, 3)
    expected = (truth * latlong_solid_angles(256, 512)[..., None]).sum((0, 1))
    solid = latlong_solid_angles(32, 64)[..., None]
    dark, found = ((read_hdr(tmp_path / f"{n}.exr") * solid).sum((0, 1)) for n in ("dark", "light"))
    assert (dark < 0.93 * expected).all()
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_regions_continue_over_the_border() -> None:
    clipped = np.zeros((8, 16), bool)
    clipped[3, [0, 15]] = clipped[4, 15] = clipped[6, 7] = True
    found = _regions(clipped)
    assert found[3, 0] == found[3, 15] == found[4, 15] == 1 and found[6, 7] == 2 and (found > 0).sum() == 4


def test_one_photograph_leaves_directions_behind_the_ball(tmp_path: Path) -> None:
    photos = write(tmp_path / "ball", [photograph(EYES[0], sky)])
    code, said = probe(photos, "-o", tmp_path / "light.exr", "--rows", 32)
    found = read_hdr(tmp_path / "light.exr")
    assert code == 0 and np.isfinite(found).all() and "1 photographs" in said
    unseen = float(said.split(" of the directions were not seen")[0].rpartition(" ")[2].rstrip("%"))
    assert 2 < unseen < 12  # a cone of 30 to 40 degrees
    assert np.median(relative_error(found, sky)) < 0.02  # those behind are filled from beside them


def test_the_photographer_is_seen_by_other_cameras(tmp_path: Path) -> None:
    """A dark figure around each camera, in that camera's photograph alone."""

    def photographer(eye: Sequence[float]) -> Callable[[Rows], Rows]:
        toward = (np.array(eye) - CENTER) / np.linalg.norm(np.array(eye) - CENTER)
        return lambda d: np.where((d @ toward > np.cos(np.radians(4)))[:, None], 0.01, sky(d))

    photos = write(tmp_path / "ball", [photograph(eye, photographer(eye)) for eye in EYES])
    assert probe(photos, "-o", tmp_path / "light.exr", "--rows", 32)[0] == 0
    assert relative_error(read_hdr(tmp_path / "light.exr"), sky).max() < 0.1


def test_the_sphere_is_that_of_the_outlines() -> None:
    seen = [photograph(eye, sky) for eye in EYES]
    found = fit_sphere([(each.camera, each.mask.astype(np.float32)) for each in seen])
    np.testing.assert_allclose(found.center, CENTER, atol=0.003)
    assert found.radius == pytest.approx(RADIUS, rel=0.005) and found.deviation_pixels < 0.3
    one = fit_sphere([(seen[0].camera, seen[0].mask.astype(np.float32))])
    eye = np.array(EYES[0])
    sine = one.radius / np.linalg.norm(one.center - eye)
    assert sine == pytest.approx(RADIUS / np.linalg.norm(CENTER - eye), rel=0.01)


def test_reflected_directions_follow_the_law_of_reflection() -> None:
    camera, ball = look_at(np.array(EYES[1]), CENTER, FOCAL, SIDE, SIDE), Sphere(CENTER, RADIUS, 0.0)
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    pixels, cosine, toward = reflecting_pixels(camera, ball, directions)
    chosen = cosine > 0.1
    origins, rays = camera.rays(pixels[chosen])
    b = ((origins - CENTER) * rays).sum(1)
    t = -b - np.sqrt(b**2 - ((origins - CENTER) ** 2).sum(1) + RADIUS**2)
    normal = (origins + t[:, None] * rays - CENTER) / RADIUS
    mirrored = rays - 2 * (rays * normal).sum(1, keepdims=True) * normal
    np.testing.assert_allclose(mirrored, directions[chosen], atol=1e-4)
    np.testing.assert_allclose(-rays, toward[chosen], atol=1e-6)


def test_bad_input_is_one_sentence(tmp_path: Path) -> None:
    egg = write(tmp_path / "egg", [photograph(eye, sky, squash=0.7) for eye in EYES])
    good = write(tmp_path / "good", [photograph(EYES[0], sky)])
    cases = {
        "not those of one ball": (egg, "-o", tmp_path / "a.hdr"),
        "must end in .hdr or .exr": (good, "-o", tmp_path / "a.png"),
        "no effect without --grey-ball": (good, "-o", tmp_path / "a.hdr", "--grey-reflectance", "0.5"),
        "does not exist; create it": (good, "-o", tmp_path / "none" / "a.hdr"),
    }
    document = json.loads((good / "transforms.json").read_text())
    opaque = tmp_path / "opaque"
    opaque.mkdir()
    Image.open(good / "0.png").convert("RGB").save(opaque / "0.png")
    (opaque / "transforms.json").write_text(json.dumps(document))
    cases["masks of the photographs"] = (opaque, "-o", tmp_path / "a.hdr")
    soft = photograph(EYES[0], sky)
    soft_masks = write(tmp_path / "soft", [Photograph(soft.camera, soft.color, 0.9 * soft.mask)])
    cases["no photograph shows a reflection"] = (soft_masks, "-o", tmp_path / "a.hdr")
    cases["does not exist; give the folder"] = (tmp_path / "nowhere", "-o", tmp_path / "a.hdr")
    mixed = write(tmp_path / "mixed", [photograph(eye, sky) for eye in EYES], [1.0] * 3)
    Image.open(mixed / "1.png").save(mixed / "1.png", exif=Image.Exif())
    cases["records no exposure, others do"] = (mixed, "-o", tmp_path / "a.hdr")
    for words, arguments in cases.items():
        code, said = probe(*arguments)
        assert code != 0 and words in said and "Traceback" not in said, (words, said)
        assert not (tmp_path / "a.hdr").exists()
