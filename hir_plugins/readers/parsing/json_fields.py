"""JSON files of a capture, and numbers in them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from hir_exporters.files.regular_files import refuse_special_file
from hir_exporters.files.untrusted_json import parse_json

from hir_core.errors import CaptureError, InputError
from hir_plugins.readers.parsing.capture_paths import MAX_TEXT_BYTES


def read_json(path: Path) -> dict[str, object]:
    """The object in a JSON file; anything else raises a `CaptureError` that names the file."""
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise CaptureError(f"{path} is larger than {MAX_TEXT_BYTES >> 20} MB; it is not a camera file")
        refuse_special_file(path)
        content = parse_json(path.read_bytes())
    except CaptureError:
        raise
    except InputError as error:
        raise CaptureError(str(error)) from None
    except OSError as error:
        raise CaptureError(f"{path} cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path} is not valid JSON ({error}); export it again") from None
    if not isinstance(content, dict):
        raise CaptureError(f"{path} is not a JSON object; export it again")
    return content


def number_field(table: Mapping[str, object], key: str, owner: str, default: float | None = None) -> float | None:
    """A finite number of a JSON object, or `default` if the key is absent or null."""
    value = table.get(key)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CaptureError(f"{owner}: {key!r} is {value!r}; write a finite number")
    return float(value)
