"""Runs a `hir` command with another value of a constant of the code.

`python -m benchmarks.changed_constant PACKAGE:NAME=VALUE COMMAND…`. The line `NAME = …` of the one module of PACKAGE
that has it is replaced before that module is compiled, so that all imports and default arguments have the new value.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from hir_core.errors import ConfigError


def find_constant(package: str, name: str) -> tuple[str, Path, float]:
    """Module, file and value of a constant that one module of a package defines by a number.

    `ConfigError` where none does, or several.
    """
    spec = importlib.util.find_spec(package)
    folders = list(spec.submodule_search_locations or ()) if spec else []
    found = []
    for path in sorted(Path(folder) / file for folder in folders for file in Path(folder).glob("*.py")):
        match = _line(name).search(path.read_text(encoding="utf-8"))
        if match:
            found.append((f"{package}.{path.stem}", path, float(match["value"])))
    if len(found) != 1:
        raise ConfigError(f"{package}: {len(found)} modules define {name} as a number, not one")
    return found[0]


def _line(name: str) -> re.Pattern[str]:
    return re.compile(rf"^(?P<head>{re.escape(name)}(: Final)? = )(?P<value>[0-9._e+-]+)$", re.MULTILINE)


class ChangedLoader(SourceFileLoader):
    """Compiles a module with another value of one constant; the byte code is not stored."""

    def __init__(self, module: str, path: Path, name: str, value: float) -> None:
        super().__init__(module, str(path))
        self._name, self._value = name, value

    def get_code(self, fullname: str) -> CodeType:
        """The code of the changed source."""
        source = Path(self.path).read_text(encoding="utf-8")
        changed, count = _line(self._name).subn(lambda match: f"{match['head']}{self._value!r}", source)
        assert count == 1
        return compile(changed, self.path, "exec", dont_inherit=True)


class ChangedConstant(MetaPathFinder):
    """Finds the one module with a changed constant."""

    def __init__(self, package: str, name: str, value: float) -> None:
        self.module, self._path, _ = find_constant(package, name)
        self._loader = ChangedLoader(self.module, self._path, name, value)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of the changed module; None for every other one."""
        if fullname != self.module:
            return None
        return importlib.util.spec_from_file_location(fullname, self._path, loader=self._loader)


def install(text: str) -> ChangedConstant:
    """Changes a constant, given as `PACKAGE:NAME=VALUE`, for all later imports.

    `ConfigError` for other text, and where the module was imported already.
    """
    match = re.fullmatch(r"(?P<package>[\w.]+):(?P<name>\w+)=(?P<value>[0-9._e+-]+)", text)
    if match is None:
        raise ConfigError(f"{text!r}: write it as PACKAGE:NAME=VALUE, with a number")
    finder = ChangedConstant(match["package"], match["name"], float(match["value"]))
    if finder.module in sys.modules:
        raise ConfigError(f"{finder.module} is imported already; its constants cannot be changed any more")
    sys.meta_path.insert(0, finder)
    return finder


if __name__ == "__main__":
    install(sys.argv[1])
    from hir_core.cli import main

    main(sys.argv[2:])
