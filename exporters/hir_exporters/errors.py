"""Errors that a user sees: one sentence that names the file or field and the remedy."""

from __future__ import annotations


class HirError(Exception):
    """Base class of errors that are shown to a user without a traceback."""


class InputError(HirError):
    """An input (a file, an array, an option) is missing, malformed or out of range."""


class ExportError(HirError):
    """A file could not be written, or the asset cannot be expressed in the requested format."""
