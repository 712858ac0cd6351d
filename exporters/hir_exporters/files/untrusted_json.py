"""JSON of files of others: without numbers and texts that Python accepts and other parts of a program do not."""

from __future__ import annotations

import json
import re
from typing import Any, Final

MAX_INTEGER_DIGITS: Final = 19
"""Digits of the largest 64-bit integers; Python's own integers become floats only below 309 digits."""

_SURROGATE: Final = re.compile(r"\\u[dD][89a-fA-F]")


def parse_json(text: str | bytes) -> Any:
    """A document; `ValueError` where it is not JSON, has an integer of more than 19 digits, or half a character.

    Half a character is an escape such as `\\ud800` without its second half, which no file name and no output can hold.
    """
    decoded = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    document = json.loads(decoded, parse_int=_integer)
    if _SURROGATE.search(decoded):
        json.dumps(document, ensure_ascii=False).encode()
    return document


def _integer(digits: str) -> int:
    if len(digits.lstrip("-")) > MAX_INTEGER_DIGITS:
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)
