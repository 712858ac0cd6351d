"""Errors that a user can mend. Each message names the thing, what is wrong with it and what to do."""

from __future__ import annotations

from hir_exporters.errors import HirError, InputError

__all__ = ["CaptureError", "ConfigError", "HirError", "InputError", "MissingExtraError", "PluginError", "StageError"]


class CaptureError(InputError):
    """A capture cannot be read or does not hold what a stage needs."""


class ConfigError(HirError):
    """A setting is unknown, misspelt or out of range."""


class PluginError(HirError):
    """A plugin is broken, unknown or in conflict with another."""


class MissingExtraError(HirError):
    """A component needs packages that are not installed."""


class StageError(HirError):
    """A stage could not produce a result."""
