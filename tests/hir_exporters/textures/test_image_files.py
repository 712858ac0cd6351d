import struct
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import ExportError, InputError
from hir_exporters.textures import image_files
from hir_exporters.textures.rgbe import RgbeError, decode_rgbe, encode_rgbe
from hypothesis import example, given, settings
from hypothesis import strategies as st
from PIL import Image


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.random((height, width, 3)) * np.exp(rng.normal(0, 4, (height, width, 1)))).astype(np.float32)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_holds_its_8_bit_codes(tmp_path: Path, channels: int) -> None:
    codes = np.random.default_rng(0).integers(0, 256, (5, 7, channels), dtype=np.uint8)
    image_files.write_png(tmp_path / "a.png", codes)
    np.testing.assert_array_equal(image_files.read_ldr(tmp_path / "a.png"), codes.astype(np.float32) / np.float32(255))


@pytest.mark.parametrize("channels", [1, 3])
def test_png_holds_its_16_bit_codes(tmp_path: Path, channels: int) -> None:
    codes = np.random.default_rng(0).integers(0, 65536, (6, 3, channels), dtype=np.uint16)
    image_files.write_png(tmp_path / "a.png", codes)
    with Image.open(tmp_path / "a.png") as image:
        image.load()  # Pillow checks every CRC and unfilters the rows
        assert image.size == (3, 6)
    if channels == 1:
        np.testing.assert_array_equal(image_files.read_ldr(tmp_path / "a.png") * np.float32(65535), codes)
    else:
        assert np.abs(image_files.read_ldr(tmp_path / "a.png") * 65535 - codes).max() <= 257


@pytest.mark.parametrize("kind", ["noise", "waves", "flat"])
@pytest.mark.parametrize("shape", [(1, 1, 3), (255, 3, 3), (256, 8, 4), (700, 9, 1), (2, 700, 3)])
def test_another_decoder_reads_png_of_any_size_and_content(shape: tuple[int, ...], kind: str) -> None:
    import io

    y, x, c = np.indices(shape)
    codes = {
        "noise": np.random.default_rng(0).integers(0, 256, shape),
        "waves": 128 + 100 * np.sin(x / 5 + y / 9 + c),
        "flat": np.full(shape, 7),
    }[kind].astype(np.uint8)
    with Image.open(io.BytesIO(image_files.encode_png(codes))) as image:
        np.testing.assert_array_equal(np.asarray(image).reshape(shape), codes)


def test_floats_are_rounded_to_the_nearest_code() -> None:
    np.testing.assert_array_equal(image_files.quantize(np.arange(256) / 255), np.arange(256))
    np.testing.assert_array_equal(image_files.quantize(np.array([-1, 2.0])), [0, 255])
    with pytest.raises(ExportError, match="NaN"):
        image_files.quantize(np.array([np.nan]))


def test_palettes_cmyk_and_one_bit_become_plain(tmp_path: Path) -> None:
    source = Image.new("RGB", (4, 2), (255, 0, 0))
    for name, image, channels in [
        ("p.png", source.convert("P"), 3),
        ("c.jpg", source.convert("CMYK"), 3),
        ("b.png", source.convert("1"), 1),
    ]:
        image.save(tmp_path / name)
        assert image_files.read_ldr(tmp_path / name).shape == (2, 4, channels)


@pytest.mark.parametrize("shape", [(4, 8), (3, 200), (5, 3), (1, 1), (2, 40000)])
def test_radiance_file_keeps_each_pixel_within_half_a_step(tmp_path: Path, shape: tuple[int, int]) -> None:
    radiance = picture(*shape)
    image_files.write_hdr(tmp_path / "a.hdr", radiance)
    read = image_files.read_hdr(tmp_path / "a.hdr")
    assert (np.abs(read - radiance).max(-1) <= radiance.max(-1) / 256 * (1 + 1e-6)).all()
    image_files.write_hdr(tmp_path / "b.hdr", read)
    np.testing.assert_array_equal(image_files.read_hdr(tmp_path / "b.hdr"), read)


@given(st.floats(0, 1e38), st.floats(0, 1))
@example(2.1973108664972164e-39, 0.0)
@settings(max_examples=200)
def test_radiance_codes_are_right_at_any_magnitude(value: float, fraction: float) -> None:
    pixel = np.array([[[value, value * fraction, 0.0]]], dtype=np.float32)
    decoded = decode_rgbe(encode_rgbe(pixel))
    smallest = 2.0**-128  # mantissa 128 at exponent 1: what is less becomes 0
    assert np.abs(decoded - pixel).max() <= max(pixel.max() / 256, smallest)


def test_old_and_new_run_lengths_and_flips_are_read() -> None:
    pixels = np.array([[[128, 64, 32, 129]] * 5 + [[200, 0, 0, 130]] * 5], dtype=np.uint8)
    flat = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 10\n" + pixels.tobytes()
    old = b"#?RGBE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 10\n" + bytes(
        [128, 64, 32, 129, 1, 1, 1, 4, 200, 0, 0, 130, 1, 1, 1, 4]
    )
    runs = b"".join(bytes([128 + 5, a, 128 + 5, b]) for a, b in zip(pixels[0, 0], pixels[0, 9], strict=True))
    new = b"#?RADIANCE\n\n-Y 1 +X 10\n" + bytes([2, 2, 0, 10]) + runs
    expected = decode_rgbe(flat)
    np.testing.assert_array_equal(expected[0, 0], [1.0, 0.5, 0.25])
    np.testing.assert_array_equal(decode_rgbe(old), expected)
    np.testing.assert_array_equal(decode_rgbe(new), expected)
    np.testing.assert_array_equal(decode_rgbe(flat.replace(b"+X 10", b"-X 10")), expected[:, ::-1])
    np.testing.assert_array_equal(decode_rgbe(flat.replace(b"\n\n", b"\nEXPOSURE=2\n\n")), expected / 2)


def test_radiance_file_agrees_with_another_reader(shared: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="opencv is the independent reader")
    path = shared / "envmaps" / "park.hdr"
    np.testing.assert_array_equal(image_files.read_hdr(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1])


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_exr_holds_float32_exactly(tmp_path: Path, channels: int) -> None:
    pixels = np.random.default_rng(0).normal(0, 1e6, (5, 9, channels)).astype(np.float32)
    image_files.write_exr(tmp_path / "a.exr", pixels)
    np.testing.assert_array_equal(image_files.read_exr(tmp_path / "a.exr"), pixels)
    if channels != 4:
        np.testing.assert_array_equal(image_files.read_hdr(tmp_path / "a.exr"), np.broadcast_to(pixels, (5, 9, 3)))


@pytest.mark.parametrize("writer", ["write_hdr", "write_exr", "write_png"])
def test_bytes_repeat(tmp_path: Path, writer: str) -> None:
    pixels = np.clip(picture(16, 32), 0, 1)
    for name in "ab":
        getattr(image_files, writer)(tmp_path / name, pixels)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_non_finite_radiance_is_refused_both_ways(tmp_path: Path, value: float) -> None:
    import OpenEXR

    bad = np.full((2, 2, 3), value, np.float32)
    for write in (image_files.write_hdr, image_files.write_exr):
        with pytest.raises(ExportError, match="bad"):
            write(tmp_path / "bad", bad)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": bad}).write(str(tmp_path / "bad.exr"))
    with pytest.raises(InputError, match=r"bad\.exr contains 12 NaN"):
        image_files.read_hdr(tmp_path / "bad.exr")


@pytest.mark.parametrize("suffix", ["png", "jpg", "hdr", "exr"])
def test_truncated_and_scrambled_files_name_themselves(tmp_path: Path, suffix: str) -> None:
    good = tmp_path / f"good.{suffix}"
    pixels = np.clip(picture(24, 24), 0, 1)
    if suffix == "jpg":
        Image.fromarray(image_files.quantize(pixels)).save(good)
    else:
        {"png": image_files.write_png, "hdr": image_files.write_hdr, "exr": image_files.write_exr}[suffix](good, pixels)
    read = image_files.read_ldr if suffix in ("png", "jpg") else image_files.read_hdr
    data = good.read_bytes()
    bad = tmp_path / f"bad.{suffix}"
    for cut in (0, 3, 20, len(data) // 2):
        bad.write_bytes(data[:cut])
        with pytest.raises(InputError, match=f"bad.{suffix}"):
            read(bad)
    rng = np.random.default_rng(1)
    for _ in range(40):
        scrambled = bytearray(data)
        for index in rng.integers(0, len(data), 6):
            scrambled[index] = rng.integers(256)
        bad.write_bytes(scrambled)
        try:
            assert np.isfinite(read(bad)).all()
        except InputError as error:
            assert f"bad.{suffix}" in str(error)


def test_a_huge_header_is_refused_before_anything_is_decoded(tmp_path: Path) -> None:
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\n\n-Y 99999999 +X 99999999\n")
    (tmp_path / "b.hdr").write_bytes(b"#?RADIANCE\n\n-Y 9000 +X 9000\n\x02\x02\x23\x28")
    Image.new("1", (16384, 16384)).save(tmp_path / "c.png")
    for name, read in (
        ("a.hdr", image_files.read_hdr),
        ("b.hdr", image_files.read_hdr),
        ("c.png", image_files.read_ldr),
    ):
        with pytest.raises(InputError, match=name):
            read(tmp_path / name)
    with pytest.raises(InputError, match="does not exist"):
        image_files.read_ldr(tmp_path / "none.png")


def test_exr_channels_may_have_different_types(tmp_path: Path) -> None:
    import OpenEXR

    pixels = np.random.default_rng(0).random((4, 6, 4), np.float32)
    for half in ("R", "B", "A", "RGBA"):
        planes = {c: pixels[..., i].astype(np.float16 if c in half else np.float32) for i, c in enumerate("RGBA")}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, dict(planes)).write(str(tmp_path / "a.exr"))
        read = image_files.read_exr(tmp_path / "a.exr")
        np.testing.assert_array_equal(read, np.stack([planes[c].astype(np.float32) for c in "RGBA"], -1))
        np.testing.assert_array_equal(image_files.read_exr(tmp_path / "a.exr", channels=3), read[..., :3])


def test_subsampled_exr_is_refused(tmp_path: Path) -> None:
    image_files.write_exr(tmp_path / "half.exr", np.ones((4, 6), np.float32))
    whole = (tmp_path / "half.exr").read_bytes()
    entry = b"Y\0" + struct.pack("<IBxxx", 2, 0)  # float32, not perceptually linear; then both samplings
    assert entry + struct.pack("<II", 1, 1) in whole
    (tmp_path / "half.exr").write_bytes(
        whole.replace(entry + struct.pack("<II", 1, 1), entry + struct.pack("<II", 2, 2))
    )
    with pytest.raises(InputError, match=r"half\.exr has subsampled channels"):
        image_files.read_exr(tmp_path / "half.exr")


def test_the_predictor_of_png_is_that_of_its_text() -> None:
    """ISO 15948, 9.4: of left, up and corner the one nearest to left + up - corner, in this order where they tie."""
    from hir_exporters.textures.png_encoding import _paeth

    codes = np.arange(256, dtype=np.uint8)
    for first in range(0, 256, 64):
        left, up, corner = np.meshgrid(codes[first : first + 64], codes, codes, indexing="ij")
        a, b, c = (values.astype(np.int16) for values in (left, up, corner))
        near_left, near_up, near_corner = abs(b - c), abs(a - c), abs(a + b - 2 * c)
        wanted = np.where(
            (near_left <= near_up) & (near_left <= near_corner), a, np.where(near_up <= near_corner, b, c)
        )
        np.testing.assert_array_equal(_paeth(left, up, corner), wanted)


def test_a_cut_off_exr_is_reported_once_and_not_row_by_row(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    image_files.write_exr(tmp_path / "cut.exr", np.random.default_rng(0).random((256, 256, 3), dtype=np.float32))
    (tmp_path / "cut.exr").write_bytes((tmp_path / "cut.exr").read_bytes()[:5000])
    with pytest.raises(InputError, match=r"cut\.exr is a broken OpenEXR file"):
        image_files.read_exr(tmp_path / "cut.exr")
    print("the streams are there again", flush=True)
    output = capfd.readouterr()
    assert output.out == "the streams are there again\n" and output.err == ""


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (b"FORMAT=32-bit_rle_xyze\n", "only 32-bit_rle_rgbe is read"),
        (b"EXPOSURE=bright\n", "'EXPOSURE=bright' is not a number"),
        (b"COLORCORR=1 2\n", "'COLORCORR=1 2' is not a number"),
        (b"EXPOSURE=-1\n", "EXPOSURE is not a positive number"),
        (b"EXPOSURE=nan\n", "EXPOSURE is not a positive number"),
        (b"EXPOSURE=1e-300\n", "beyond float32"),
    ],
)
def test_headers_of_hdr_files_that_make_no_sense(header: bytes, said: str) -> None:
    body = b"\n-Y 1 +X 2\n" + bytes([128, 64, 32, 129] * 2)
    with pytest.raises(RgbeError, match=said):
        decode_rgbe(b"#?RADIANCE\n" + header + body)


@pytest.mark.parametrize("size", [b"-Y 0 +X 2", b"-Y 2 +X 0", b"+X 2 -Y 1", b"-Y 1", b""])
def test_hdr_files_without_a_size(size: bytes) -> None:
    with pytest.raises(RgbeError, match=r"no pixels|resolution line"):
        decode_rgbe(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + size + b"\n" + bytes(8))


def test_exposure_and_colour_correction_of_hdr_files_are_undone() -> None:
    """Both may come more than once: their products count."""
    pixel = bytes([128, 64, 32, 129])
    plain = decode_rgbe(b"#?RADIANCE\n\n-Y 1 +X 1\n" + pixel)
    header = b"EXPOSURE=2\nEXPOSURE=4\nCOLORCORR=1 2 4\n"
    np.testing.assert_allclose(
        decode_rgbe(b"#?RADIANCE\n" + header + b"\n-Y 1 +X 1\n" + pixel), plain / np.array([8, 16, 32]), rtol=1e-6
    )


def test_nan_is_not_encoded_as_black() -> None:
    radiance = np.ones((2, 3, 3))
    radiance[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        encode_rgbe(radiance)
