"""Writes docs/writing_plugins/faults.md: broken plugins, the contract that each fails, and the sentence it says.

python tools/write_fault_table.py [BROKEN_PLUGIN …]
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from hir_core.plugins.manager import PluginManager
from hir_core.testing import Result, check_component, check_whole_plugin, whole_plugin
from hir_core.testing.running import named, plugin_checks

ROOT = Path(__file__).resolve().parent.parent
FAULTS_FOLDER = ROOT / "tests" / "hir_core" / "testing" / "faults"
PAGE = ROOT / "docs" / "writing_plugins" / "faults.md"

FAULTS: Final[Mapping[str, str]] = {
    "wrong_gradient": "gradient_is_that_of_the_value",
    "detached_graph": "gradient_is_that_of_the_value",
    "nan": "term_is_a_finite_scalar",
    "wrong_shape": "term_is_a_finite_scalar",
    "not_rigid_invariant": "rigid_motion_changes_nothing",
    "mutated_input": "inputs_stay_as_they_are",
    "global_seed": "process_stays_as_it_is",
    "slow_import": "imports_quickly",
    "torch_at_load": "imports_light",
    "name_conflict": "names_are_free",
    "wrong_interface": "is_made_for_this_interface",
    "missing_extra": "missing_extra_is_named",
    "thawed_options": "default_options_construct",
    "reader_leaves_its_folder": "stays_in_its_folder",
    "exporter_writes_elsewhere": "writes_below_its_destination",
    "exporter_other_bytes": "same_bytes_twice",
    "wrong_unit": "reads_back",
    "initializer_other_frame": "surface_is_the_true_one",
    "renderer_by_thread_count": "thread_counts_agree",
    "renderer_by_device": "devices_agree",
    "observer_raises": "observer_raises_nothing",
    "command_shadows": "names_are_free",
    "registers_nothing": "registers_something",
    "in_place_write": "inputs_stay_as_they_are",
    "unnamed_trait": "traits_name_what_it_reads",
    "ideal_not_least": "smallest_on_its_ideal",
    "root_of_difference": "hard_scenes_stay_finite",
    "reader_parent_folder": "stays_in_its_folder",
    "reader_unchecked_number": "malformed_files_are_refused",
    "double_precision_mesh": "returns_capture_and_scene",
    "scene_alone": "returns_capture_and_scene",
    "gray_radiance": "radiance_is_finite_and_in_place",
    "nan_beside_the_object": "radiance_is_finite_and_in_place",
    "light_turned_back": "light_has_its_frame",
    "light_fixed_to_the_world": "light_has_its_frame",
    "exporter_needs_its_folder": "writes_below_its_destination",
    "command_raises": "commands_refuse_what_is_missing",
}
"""File of each broken plugin, and the contract that names its fault."""
NEEDS_CUDA: Final = ("renderer_by_device",)
INSTALLED: Final = ("missing_extra",)
"""Broken plugins whose fault shows only where they are installed as a distribution."""
PLACE: Final = "PLUGIN.py"
"""How the page names the file of a plugin."""


def results_of(fault: str, only: str = "") -> list[Result]:
    """The results of `hir check-plugin` for a broken plugin; of one contract where `only` names it."""
    with _plugin(fault) as (name, plugins):
        whole = whole_plugin(name, plugins)
        assert whole is not None, name
        results: list[Result] = []
        chosen, of_plugins = {only} - {""}, {check.name for check in plugin_checks()}
        if not chosen or chosen & of_plugins:
            results += check_whole_plugin(whole, only=chosen, raises=False)
        if not chosen & of_plugins:
            for registered in named(name, plugins):
                results += check_component(registered, only=chosen, plugins=plugins, raises=False)
        return [_with_short_names(result, name) for result in results] if fault not in INSTALLED else results


def sentence_of(result: Result) -> str:
    """What a failed check saw."""
    (seen,) = [line for line in result.detail.splitlines() if line.startswith("  seen:")]
    return seen.removeprefix("  seen:").strip()


@contextmanager
def _plugin(fault: str) -> Iterator[tuple[str, PluginManager]]:
    """The plugin's name, and a manager that loaded it."""
    file = FAULTS_FOLDER / f"{fault}.py"
    if fault not in INSTALLED:
        yield str(file), PluginManager.discover((str(file),), strict=False)
        return
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(file, Path(folder) / f"hir_{fault}.py")
        info = Path(folder) / f"hir_{fault}-1.0.dist-info"
        info.mkdir()
        distribution = f"hir-{fault.replace('_', '-')}"
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\nRequires-Dist: hir\n"
        )
        (info / "entry_points.txt").write_text(f"[hir]\n{fault} = hir_{fault}\n")
        sys.path.insert(0, folder)
        try:
            yield distribution, PluginManager.discover()
        finally:
            sys.path.remove(folder)


def _with_short_names(result: Result, name: str) -> Result:
    detail = result.detail.replace(name, PLACE).replace(f"hir_plugin_{Path(name).stem}", "hir_plugin_PLUGIN")
    return replace(result, detail=detail)


def documentation(fault: str) -> str:
    """The first line of a broken plugin."""
    return (FAULTS_FOLDER / f"{fault}.py").read_text(encoding="utf-8").splitlines()[0].strip('"')


def row(fault: str, contract: str, sentence: str) -> str:
    """A row of the table."""
    code = f"tests/hir_core/testing/faults/{fault}.py"
    cells = (f"`{Path(code).stem}`", documentation(fault), f"[{contract}](contracts.md#{contract})", sentence)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def stored_rows() -> dict[str, str]:
    """The rows of the page, by broken plugin."""
    lines = PAGE.read_text(encoding="utf-8").splitlines() if PAGE.exists() else []
    return {line.split("`")[1]: line for line in lines if line.startswith("| `")}


def main(chosen: Sequence[str] = ()) -> None:
    """Checks the broken plugins that are named, or all, and writes the page; the others keep their rows.

    So does one that needs CUDA where there is none.
    """
    import torch

    stored, rows = stored_rows(), []
    for fault, contract in FAULTS.items():
        if chosen and fault not in chosen:
            rows += [stored[fault]] if fault in stored else []
        elif fault in NEEDS_CUDA and not torch.cuda.is_available():
            rows.append(stored.get(fault) or row(fault, contract, "*(on a machine with CUDA)*"))
        else:
            failed = [result for result in results_of(fault) if result.outcome == "failed"]
            assert [result.check for result in failed] == [contract], [result.detail for result in failed]
            rows.append(row(fault, contract, sentence_of(failed[0])))
    PAGE.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


HEAD: Final = """# Faults and what names them

Written by `python tools/write_fault_table.py`, which runs `hir check-plugin` on broken plugins. Each has one fault and
fails one contract; they lie in `tests/hir_core/testing/faults`. The last column is what is printed after `seen:`.

| broken plugin | its fault | contract | what is printed |
|---|---|---|---|
"""

if __name__ == "__main__":
    main(sys.argv[1:])
