"""XML files of a capture, from untrusted sources."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from hir_exporters.files.regular_files import refuse_special_file

from hir_core.errors import CaptureError

MAX_XML_BYTES = 64 << 20
"""Largest accepted size; its tree takes about ten times as much memory."""


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file in UTF-8.

    Documents that define entities are refused, because those can grow without bound. Anything else raises a
    `CaptureError` that names the file.
    """
    try:
        if path.stat().st_size > MAX_XML_BYTES:
            raise CaptureError(f"{path} is larger than {MAX_XML_BYTES >> 20} MB; it is not a camera file")
        refuse_special_file(path)
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise CaptureError(f"{path} cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise CaptureError(f"{path} is not in UTF-8; export it again") from None
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise CaptureError(f"{path} defines a document type; camera files need none, export it again")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise CaptureError(f"{path} is not valid XML ({error}); export it again") from None
