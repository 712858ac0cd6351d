"""A plugin as one file for `--plugin`, from the templates of a package."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable

IMPORT = re.compile(r"^(?:from (\S+) )?import (.+)$")


def joined(implementation: str, options: str, descriptor: str, summary: str) -> str:
    """One module from the three modules of a package, whose lines that import `Options` have been removed.

    The options follow the imports, the descriptor is the end.
    """
    modules = [_split(implementation), _split(options), _split(descriptor)]
    imports = _merged(line for lines, _ in modules for line in lines)
    (guarded, code), own, end = _guarded(modules[0][1]), modules[1][1], modules[2][1]
    parts = [f'"""{summary}"""', imports, *([guarded] if guarded else [])]
    return "\n\n".join(parts) + "\n\n\n" + "\n\n\n".join((own, code, end)) + "\n"


def _split(module: str) -> tuple[list[str], str]:
    """The imports at the left margin, and the code behind them, without the docstring of the module."""
    lines = module[module.index('"""', 3) + 3 :].splitlines()
    found = [line for line in lines if IMPORT.match(line)]
    rest = "\n".join(line for line in lines if not IMPORT.match(line))
    return found, rest.strip()


def _guarded(code: str) -> tuple[str, str]:
    """The block of imports for type checkers, or an empty string, and the code behind it."""
    if not code.startswith("if TYPE_CHECKING:"):
        return "", code
    block = re.match(r"if TYPE_CHECKING:\n(?:    .*\n)+", code)
    assert block is not None
    return block.group().strip("\n"), code[block.end() :].strip("\n")


def _merged(lines: Iterable[str]) -> str:
    """The imports of several modules as those of one: first the standard library's, then the others, sorted."""
    names: dict[tuple[int, bool, str], set[str]] = {}
    for line in lines:
        found = IMPORT.match(line)
        assert found is not None
        module = found.group(1) or found.group(2)
        top = module.partition(".")[0]
        group = 0 if top == "__future__" else 1 if top in sys.stdlib_module_names else 2
        wanted = names.setdefault((group, found.group(1) is not None, module), set())
        if found.group(1) is not None:
            wanted |= {name.strip() for name in found.group(2).split(",")}
    groups: dict[int, list[str]] = {}
    for (group, is_from, module), wanted in sorted(names.items()):
        ordered = sorted(wanted, key=lambda name: (not name.isupper(), name.islower(), name.lower()))
        groups.setdefault(group, []).append(
            f"from {module} import {', '.join(ordered)}" if is_from else f"import {module}"
        )
    return "\n\n".join("\n".join(groups[group]) for group in sorted(groups))
