"""The test of Mitsuba's variant: it runs once, its success is cached, and a failure is one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hir_core.errors import MissingExtraError
from hir_core.run import installation_check
from hir_core.run.installation_check import Finding
from hir_plugins.reflectance_renderers import mitsuba_variant


@pytest.fixture()
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    mitsuba_variant.check_variant.cache_clear()
    yield tmp_path
    mitsuba_variant.check_variant.cache_clear()


def test_success_is_cached_for_later_processes(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def examine(name: str, label: str) -> Finding:
        asked.append(name)
        return Finding(label, "ok", name)

    monkeypatch.setattr(installation_check, "examine_renderer", examine)
    mitsuba_variant.check_variant("llvm_ad_rgb")
    mitsuba_variant.check_variant.cache_clear()  # as another process would
    mitsuba_variant.check_variant("llvm_ad_rgb")
    assert asked == ["llvm_ad_rgb"]
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/elsewhere/libLLVM.so")
    mitsuba_variant.check_variant.cache_clear()
    mitsuba_variant.check_variant("llvm_ad_rgb")
    assert len(asked) == 2, "another LLVM is tried anew"


def test_failure_names_what_to_install_every_time(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = Finding("x", "broken", "llvm_ad_rgb: Cannot select: fminimum", "install LLVM 17 or newer: libllvm19")
    monkeypatch.setattr(installation_check, "examine_renderer", lambda *_: broken)
    with pytest.raises(MissingExtraError, match="libllvm19"):
        mitsuba_variant.check_variant("llvm_ad_rgb")
    assert not list(empty_cache.rglob("mitsuba-*"))
