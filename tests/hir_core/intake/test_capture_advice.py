"""Advice of `hir check`: one sentence for each problem, none for a good capture."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hir_core.intake.capture_advice import advice_for
from hir_core.intake.check_result import CaptureCheck, TakeCheck, ViewCheck

VIEWS = tuple(ViewCheck(f"{i:02}", 64, 48, 0.0, 0.3, 1.0, 0.2, agreement=0.9) for i in range(25))
GOOD = CaptureCheck(VIEWS, (), len(VIEWS), 0.6, 0, 0.1)


def with_view(**changes: object) -> CaptureCheck:
    """The good capture, its third photograph changed."""
    return replace(GOOD, views=(*VIEWS[:2], replace(VIEWS[2], **changes), *VIEWS[3:]))  # type: ignore[arg-type]


def test_a_good_capture_needs_no_advice() -> None:
    assert advice_for(GOOD) == []


@pytest.mark.parametrize(
    ("check", "sentence"),
    [
        (replace(GOOD, views=VIEWS[:6], with_camera=6), "6 photographs are few"),
        (replace(GOOD, with_camera=20), "5 of 25 photographs have no camera"),
        (replace(GOOD, views=tuple(replace(v, agreement=0.5) for v in VIEWS)), "do not agree (IoU 0.50)"),
        (with_view(agreement=0.7), "the masks of 02 disagree with the others"),
        (with_view(width=32), "have 2 sizes"),
        (with_view(sharpness=0.2), "1 photographs are blurred compared with the others: 02"),
        (with_view(saturated=0.2), "1 photographs have more than 5 % clipped pixels, such as 02"),
        (with_view(brightness=1.5), "differs by more than a factor of 4"),
        (with_view(touches_border=True), "reaches the border of 1 photographs, such as 02"),
        (with_view(mask_share=0), "the masks of 1 photographs are empty, such as 02"),
        (with_view(mask_share=1, touches_border=True), "the masks of 1 photographs show only object, such as 02"),
        (replace(GOOD, duplicates=(("03", "04"),)), "photographs that repeat another one: 1, such as 03 and 04"),
        (replace(GOOD, directions_covered=0.1), "cover few directions"),
        (replace(GOOD, flashes=13), "the flash fired in 13 photographs"),
        (replace(GOOD, takes=(TakeCheck("a", 20), TakeCheck("b", 5))), "the take b has 5 photographs, so its light"),
        (replace(GOOD, headlight=0.8), "the light moves with the camera (a flash"),
    ],
)
def test_each_problem_has_one_sentence(check: CaptureCheck, sentence: str) -> None:
    [advice] = advice_for(check)
    assert sentence in advice


def test_a_black_photograph_is_not_only_blurred() -> None:
    assert any("1 photographs are black, such as 02" in s for s in advice_for(with_view(sharpness=0, brightness=0)))


def test_takes_without_cameras_need_masks() -> None:
    bare = tuple(replace(v, mask_share=None, agreement=None) for v in VIEWS[:3])
    check = replace(GOOD, views=(*bare, *VIEWS[3:]), with_camera=0)
    [advice] = advice_for(check)
    assert "takes" not in advice
    [advice] = advice_for(replace(check, takes=(TakeCheck("a", 10), TakeCheck("b", 15))))
    assert "3 of 25 photographs have no mask" in advice and "takes" in advice


def test_photographs_without_a_mask_are_named() -> None:
    check = with_view(mask_share=None, agreement=None)
    [advice] = advice_for(check)
    assert advice == (
        "1 of 25 photographs have no mask, such as 02, and the capture has no points to make one from: hir "
        "reconstruct leaves these photographs out; add their masks to use them"
    )
    most = replace(check, views=tuple(replace(v, mask_share=None, agreement=None) for v in VIEWS[:13]) + VIEWS[13:])
    made = "hir reconstruct makes them from colours and reconstructed points"
    for other in (replace(check, points=100), replace(check, with_camera=0), most):
        assert made in advice_for(other)[0]


def test_the_light_of_another_take_may_be_brighter() -> None:
    bright = tuple(replace(v, take="b", brightness=10 * v.brightness) for v in VIEWS[:6])
    dark = tuple(replace(v, take="a") for v in VIEWS[6:])
    assert advice_for(replace(GOOD, views=(*bright, *dark))) == []
    assert len(advice_for(replace(GOOD, views=(*bright, *VIEWS[6:-1], replace(bright[0], take=""))))) == 1
