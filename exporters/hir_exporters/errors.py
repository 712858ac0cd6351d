"""Errors a user sees: one sentence that names the file or field and how to mend it."""

from __future__ import annotations


class HirError(Exception):
    """Base of every error shown to a user without a traceback."""


class InputError(HirError):
    """Something that was read (a file, an array, an option) is missing, malformed or out of range."""


class ExportError(HirError):
    """Something could not be written, or an asset cannot be expressed in the format asked for."""
