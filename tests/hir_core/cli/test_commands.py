"""The command line: what it prints, what it refuses, and with which exit code."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from hir_core.plugins import hookimpl
from hir_core.plugins.manager import KINDS, PluginManager
from tests.fixtures.command_line import hir

ROOT = Path(__file__).resolve().parents[3]
SAMPLE = ROOT / "examples" / "sample_capture"
LONG = "{tmp}/" + "a" * 5000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["reconstruct", "no/such/folder", "-o", "{tmp}/run"], "no/such/folder does not exist"),
        (["reconstruct", "{tmp}", "-o", "{tmp}/run"], "no capture that an installed reader knows"),
        (
            ["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "masks=nonsense"],
            "option 'masks' must be a list such as [\"name\"] or 'auto'",
        ),
        (
            ["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "reflectance.initial_radiance=-1"],
            "option 'reflectance.initial_radiance' must be a number > 0 or 'auto'",
        ),
        (
            ["reconstruct", SAMPLE, "-o", "{tmp}/run", "--preset", "fastest"],
            "no preset 'fastest'; installed: best, delight, draft, fast, paper",
        ),
        (
            ["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.iteration=3"],
            "unknown option 'geometry.iteration'; did you mean 'iterations'?",
        ),
        (["reconstruct", "", "-o", "{tmp}/run"], "Invalid value for 'CAPTURE': the path is empty"),
        (["reconstruct", SAMPLE, "-o", ""], "the path is empty; give a path, or . for the current folder"),
        (["ui", ""], "the path is empty"),
        (
            ["config", "show", "--preset", "draft", "--set", "preset=paper"],
            "the preset is 'draft', and --set names the preset 'paper'; give one of them",
        ),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "reflectance.model=glossy"], "'normal_map'"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--model", "glossy"], "'glossy' is not one of"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.iterations"], "write it as key=value"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.iterations=many"], "geometry.iterations"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.learning_rate=nan"], "finite"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.iterations=-3"], "is -3; it must be ≥ 0"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.held_out=2"], "is 2; it must be 0 … 1"),
        (
            ["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", "geometry.renderer=contuor"],
            "named 'contuor'; installed: contour",
        ),
        *(
            (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--set", setting], message)
            for setting, message in (
                ("geometry.regularizers.laplacian.wieght=1", "did you mean 'weight'? the options are: weight, "),
                ("geometry.regularizers.laplacian.weight=-1", "option 'weight' is -1; it must be ≥ 0"),
                ("geometry.regularizers.laplacian.weight=much", "option 'weight' is 'much'; it must be a number (≥ 0)"),
                (
                    "geometry.regularizers.bilateral_specular.weight=1",
                    "the term depends on material, which the geometry stage does not fit; move it to "
                    "reflectance.regularizers.bilateral_specular",
                ),
            )
        ),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--config", "{tmp}/none.toml"], "none.toml: cannot be read"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--plugin", "{tmp}/none.py"], "none.py"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/file"], "is a file; give a folder"),
        (["reconstruct", SAMPLE], "Missing option '-o'"),
        (["reconstruct", SAMPLE, "-o", "{tmp}/run", "--until", "lunch"], "'lunch' is not one of"),
        (["export", "{tmp}", "-f", "glb", "-o", "{tmp}/out"], "is neither a run nor a scene; give the folder of one"),
        (["export", "{tmp}/gone", "-f", "glb", "-o", "{tmp}/out"], "no such file or folder; give the folder of a run"),
        (["evaluate", "{tmp}"], "it has no run.json"),
        (["report", "{tmp}"], "it is not a run; make one with: hir reconstruct"),
        (["render", "{tmp}", "-o", "{tmp}/out"], "choose what to render"),
        (
            ["render", "{tmp}", "--view", "003", "--size", "64", "-o", "{tmp}/out"],
            "--size has no effect without --orbit",
        ),
        (["dance"], "No such command 'dance'"),
        (["check", LONG], "is longer than the system allows"),
        (["reconstruct", LONG, "-o", "{tmp}/run"], "is longer than the system allows"),
        (["reconstruct", SAMPLE, "-o", LONG], "is longer than the system allows"),
        (["evaluate", LONG], "is longer than the system allows"),
        (["report", LONG], "is longer than the system allows"),
        (["ui", LONG], "is longer than the system allows"),
    ],
    ids=lambda value: " ".join(str(v) for v in value[:1]) if isinstance(value, list) else str(value)[:24],
)
def test_wrong_input_is_one_sentence_and_exit_code_2(
    arguments: list[object], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("x")
    assert hir(*(str(word).replace("{tmp}", str(tmp_path)) for word in arguments)) == 2
    printed = capsys.readouterr().err
    assert message in printed and "Traceback" not in printed
    assert not (tmp_path / "run").exists()


def test_verbose_shows_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("export", tmp_path, "-f", "glb", "-o", tmp_path / "out", "-v") == 2
    assert "Traceback" in capsys.readouterr().err


def plugin_with_command(command: click.Command) -> PluginManager:
    manager = PluginManager()
    register = hookimpl(lambda cli: cli.add_command(command))
    manager.register(SimpleNamespace(__name__="example", hir_register_commands=register), "example", "1")
    return manager


def test_a_bug_is_called_one_and_exits_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("crash", plugins=plugin_with_command(click.Command("crash", callback=lambda: 1 / 0))) == 1
    printed = capsys.readouterr().err
    assert "this is a bug: ZeroDivisionError" in printed and "Traceback" not in printed


def test_a_library_of_the_system_that_is_missing_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    def needs_egl() -> None:
        raise ImportError("libEGL.so.1: cannot open shared object file: No such file or directory")

    assert hir("picture", plugins=plugin_with_command(click.Command("picture", callback=needs_egl))) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "libEGL.so.1" in line and "apt-get install libegl1" in line and "bug" not in line


@pytest.mark.parametrize(("file", "place"), [(None, "for the output"), ("big.exr", "for big.exr")])
def test_a_full_disk_is_no_bug(capsys: pytest.CaptureFixture[str], file: str | None, place: str) -> None:
    def fill() -> None:
        raise OSError(errno.ENOSPC, "No space left on device", file)

    assert hir("fill", plugins=plugin_with_command(click.Command("fill", callback=fill))) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"hir: there is no space left {place} ") and "free some" in line


@pytest.mark.parametrize("module", ["torch", "scipy"])
@pytest.mark.parametrize("name", ["reconstruct", "evaluate", "render", "report", "edit", "bench", "delight"])
def test_missing_extra_names_the_command(
    name: str, module: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, module, None)  # as where it is not installed
    (tmp_path / "scan.obj").touch()
    arguments = {
        "reconstruct": (SAMPLE, "-o", tmp_path / "run"),
        "evaluate": (tmp_path,),
        "render": (tmp_path, "--orbit", 1, "-o", tmp_path / "pictures"),
        "report": (tmp_path,),
        "edit": (tmp_path, "-o", tmp_path / "edited"),
        "bench": ("export",),
        "delight": (tmp_path / "scan.obj", SAMPLE, "-o", tmp_path / "run"),
    }
    assert hir(name, *arguments[name]) == 2
    wanted = f"hir {name} needs {module}; install it with: pip install 'hir[reconstruct]'"
    assert wanted in capsys.readouterr().err and not (tmp_path / "run").exists()


def test_plugins_json_lists_every_kind(capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("plugins", "--json") == 0
    listed = json.loads(capsys.readouterr().out)
    assert {row["kind"] for row in listed["components"]} <= set(KINDS)
    glb = next(row for row in listed["components"] if (row["kind"], row["name"]) == ("exporter", "glb"))
    assert glb["distribution"] == "hir" and glb["missing"] == [] and glb["install"] is None
    assert set(listed["presets"]) >= {"fast", "paper"} and listed["problems"] == []


def test_plugins_table_names_each_component(capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("plugins") == 0
    printed = capsys.readouterr().out
    for registered in PluginManager.discover().components():
        assert registered.component.name in printed
        assert registered.component.summary.split()[0] in printed


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_shown_settings_fed_back_are_the_same_settings(
    preset: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--preset", preset, "--set", "geometry.iterations=7", "--set", "export=['glb']", "--set", "seed=3"]
    assert hir("config", "show", *arguments) == 0
    shown = capsys.readouterr().out
    assert "iterations = 7" in shown
    (tmp_path / "settings.toml").write_text(shown, encoding="utf-8")
    assert hir("config", "show", "--config", tmp_path / "settings.toml") == 0
    assert capsys.readouterr().out == shown


def test_schema_describes_every_setting_and_component(capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("config", "schema") == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["settings"]["properties"]["initializers"]["description"].startswith("The chain")
    for registered in PluginManager.discover().components():
        assert registered.component.name in schema["components"][registered.kind]


def test_paper_preset_is_what_the_paper_prints() -> None:
    from hir_core.config import load_config

    config = load_config(PluginManager.discover(), "paper")
    geometry, reflectance = config.geometry, config.reflectance
    assert {name: dict(table)["weight"] for name, table in geometry.regularizers.items() if table} == {
        "laplacian": 1.0,
        "normal_consistency": 0.01,
        "edge_length": 1.0,
    }
    assert (geometry.renderer, geometry.iterations_per_view, geometry.views_per_step) == ("soft_silhouette", 200, 1)
    assert geometry.learning_rate * geometry.start_radius == pytest.approx(0.001), "Adam's rate in its scene"
    assert (
        reflectance.gradient.rgb_weight,
        reflectance.gradient.learning_rate,
        reflectance.gradient.learning_rate_end,
    ) == (0.1, 1e-4, 1.0)
    assert (reflectance.environment_width, reflectance.environment_height) == (512, 128)
    assert (reflectance.initial_radiance, reflectance.downsample, reflectance.gradient.iterations_per_view) == (
        0.5,
        4,
        400,
    )
    assert config.reflectance_renderer["mitsuba_ggx"] == {"samples": 4, "max_depth": 3}
    assert reflectance.brdf == "paper"


def test_command_of_a_plugin_is_listed_and_runs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = click.Command("greet", callback=lambda: click.echo("hello from a plugin"), help="Greets.")
    plugins = plugin_with_command(command)
    assert hir("greet", plugins=plugins) == 0
    assert "hello from a plugin" in capsys.readouterr().out
    assert hir("--help", plugins=plugins) == 0
    assert "Greets." in capsys.readouterr().out


def test_no_command_prints_help_and_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert hir() == 2
    assert "Usage: hir" in capsys.readouterr().out


def test_doctor_names_what_is_missing_and_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from hir_core.run import installation_check

    assert installation_check.examine_module("json", "nothing-of-that-name", "reconstruct").state == "ok"
    missing = installation_check.examine_module("no_such_module", "no-such", "reconstruct")
    assert missing.state == "missing" and "pip install 'hir[reconstruct]'" in missing.advice
    message = "ImportError: libGL.so.1: cannot open shared object file: No such file or directory"
    monkeypatch.setattr(installation_check, "_try", lambda command: (1, message))
    broken = installation_check.examine_module("json", "json", "reconstruct")
    assert broken.state == "broken" and broken.advice == "apt-get install libgl1"
    monkeypatch.setattr(installation_check, "_try", lambda command: (-6, "LLVM ERROR: Cannot select: fminimum"))
    renderer = installation_check.examine_renderer("llvm_ad_rgb", "renderer (cpu)")
    assert renderer.state == "broken" and "libllvm19" in renderer.advice and "fminimum" in renderer.detail
    assert installation_check.examine_renderer("cuda_ad_rgb", "renderer (cuda)").state == "absent", "no GPU is no fault"


def test_a_swallowed_interrupt_is_raised_when_progress_is_reported() -> None:
    """As where Ctrl-C falls into a finaliser or into an import that catches everything."""
    code = """
import os, signal
from hir_core.run.interrupt import remember_interrupts
from hir_core.run.progress_listener import ProgressListener
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
remember_interrupts()
listener = ProgressListener("geometry", PluginManager(), None)
listener.report(Progress("geometry", 1, 10, 0.1))
try:
    os.kill(os.getpid(), signal.SIGINT)
except BaseException:
    pass
try:
    listener.report(Progress("geometry", 2, 10, 0.2))
except KeyboardInterrupt:
    print("raised again")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "raised again", done.stderr


def test_interrupt_ends_with_130_and_names_resume() -> None:
    """Only the command that has `--resume`."""
    code = (
        "import sys\nimport hir_core.cli.app as app\n"
        "def stop(*_): raise KeyboardInterrupt\napp.LazyGroup.get_command = stop\napp.main([sys.argv[1]])"
    )
    for command in ("reconstruct", "plugins"):
        done = subprocess.run([sys.executable, "-c", code, command], capture_output=True, text=True, check=False)
        assert done.returncode == 130 and "interrupted" in done.stderr and "Traceback" not in done.stderr
        assert ("--resume" in done.stderr) is (command == "reconstruct")


def test_an_interrupted_command_of_a_plugin_names_resume_where_it_has_it() -> None:
    """It is imported by then; only its options tell."""
    code = """
import sys
import hir_core.cli.app as app
command = app.cli.get_command(None, sys.argv[1])
def stop(*_, **__): raise KeyboardInterrupt
command.invoke = stop
app.LazyGroup.get_command = lambda *_: command
app.main(sys.argv[1:])
"""
    for arguments, resumable in ((["delight", __file__, ".", "-o", "run"], True), (["bench"], False)):
        done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 130 and "Traceback" not in done.stderr, done.stderr
        assert ("continue the run with --resume" in done.stderr) is resumable
