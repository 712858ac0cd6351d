"""The commands of the engine itself: name and import string. No plugin can take one of these names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

ENGINE_COMMANDS: Final[Mapping[str, str]] = {
    "check": "hir_core.cli.check_command:check_command",
    "reconstruct": "hir_core.cli.reconstruct_command:reconstruct_command",
    "export": "hir_core.cli.export_command:export_command",
    "evaluate": "hir_core.cli.evaluate_command:evaluate_command",
    "render": "hir_core.cli.render_command:render_command",
    "report": "hir_core.cli.report_command:report_command",
    "edit": "hir_core.cli.edit_command:edit_command",
    "cameras": "hir_core.cli.cameras_command:cameras_command",
    "plugins": "hir_core.cli.plugins_command:plugins_command",
    "new-plugin": "hir_core.cli.new_plugin_command:new_plugin_command",
    "check-plugin": "hir_core.cli.check_plugin_command:check_plugin_command",
    "doctor": "hir_core.cli.doctor_command:doctor_command",
    "config": "hir_core.cli.config_command:config_group",
}
