"""For `make docs`: links to repository files, which are not part of the site, become code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:\.\./)+[^)#\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Keeps links between pages; a link out of docs/ becomes its text, as code where it names a file."""
    folder = Path(config["docs_dir"])
    here = (folder / page.file.src_uri).parent

    def kept_or_named(match: re.Match[str]) -> str:
        if (here / match[2]).resolve().is_relative_to(folder.resolve()):
            return match[0]
        return match[1] if "`" in match[1] or " " in match[1] else f"`{match[1]}`"

    return LINK.sub(kept_or_named, markdown)
