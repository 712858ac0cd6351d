"""JSON documents on disk: of limited size, with the same bytes for the same document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hir_exporters.files.atomic import write_text_atomic
from hir_exporters.files.regular_files import refuse_special_file
from hir_exporters.files.untrusted_json import parse_json

from hir_core.errors import InputError

_MAX_JSON_BYTES = 256 << 20


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file; anything else raises an `InputError` that names the file."""
    try:
        if path.stat().st_size > _MAX_JSON_BYTES:
            raise InputError(f"{path} is larger than {_MAX_JSON_BYTES >> 20} MiB")
        refuse_special_file(path)
        document = parse_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error})") from error
    if not isinstance(document, dict):
        raise InputError(f"{path} is not a JSON object")
    return document


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Writes a document with sorted keys: the same bytes for the same document; NaN becomes null."""
    write_text_atomic(path, json_text(document))


def json_text(document: Mapping[str, Any]) -> str:
    """What `write_json` writes."""
    return json.dumps(jsonable(document), indent=1, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n"


def jsonable(value: Any) -> Any:
    """A report's value as plain lists, dicts, strings and numbers; NaN and infinities become None."""
    if isinstance(value, Mapping):
        return {str(k): jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [jsonable(v) for v in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "tolist"):  # numpy and torch, arrays and scalars
        return jsonable(value.tolist())
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    return str(value)
