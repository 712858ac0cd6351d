"""Runs the code of a page, block by block, as its reader would: files are written, commands run, examples executed."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.S | re.M)
FILE = re.compile(r"# (\S+\.(?:py|toml))\n")
PLUGIN = re.compile(r"^# used with --plugin (\S+)$", re.M)
"""The comment of a settings file that needs a plugin, which only the command line can name."""
HEAVY = ("reconstruct", "export", "render", "view", "check")
"""Commands that need a capture or a run; `run_heavy` decides about them."""


class Reader:
    """Somebody who follows a page in an empty folder."""

    def __init__(self, folder: Path, quick: tuple[str, ...] = (), run_heavy: bool = False) -> None:
        self.folder = folder
        self.site = folder / ".site"
        self.site.mkdir(parents=True)
        self.quick, self.run_heavy = quick, run_heavy
        self.done: list[str] = []
        """What was executed, a word for each block or line."""

    def follow(self, page: Path) -> None:
        for language, code in BLOCK.findall(page.read_text(encoding="utf-8")):
            if language == "python":
                self._python(code)
            elif language == "toml":
                self._toml(code)
            elif language == "sh":
                for line in code.splitlines():
                    self._command(line)
            else:
                assert language == "text", f"{page.name}: a block of {language or 'no language'} is not executed"

    def _python(self, code: str) -> None:
        file = FILE.match(code)
        if file:
            path = self.folder / file[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(code, encoding="utf-8")
            compile(code, file[1], "exec")
            self.done.append(f"wrote {file[1]}")
        else:
            self._run([sys.executable, "-c", code])
            self.done.append("ran python")

    def _toml(self, code: str) -> None:
        file = FILE.match(code)
        assert file, "a TOML block begins with the name of its file"
        (self.folder / file[1]).write_text(code, encoding="utf-8")
        named = [word for plugin in PLUGIN.findall(code) for word in ("--plugin", plugin)]
        shown = self._run([sys.executable, "-m", "hir_core.cli", "config", "show", "--config", file[1], *named])
        asked, settings = tomllib.loads(code), tomllib.loads(shown)
        assert contains(settings, asked), f"{file[1]} asks for {asked}, the settings are {settings}"
        self.done.append(f"loaded {file[1]}")

    def _command(self, line: str) -> None:
        words = shlex.split(line, comments=True)
        if not words:
            return
        if words[:3] == ["pip", "install", "-e"]:
            self._install(self.folder / words[3].partition("[")[0])
        elif words[0] == "cp":
            source, destination = words[1:]
            shutil.copy(self.folder / source, self.folder / destination)
        elif words[0] == "pytest":
            self._run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"])
        else:
            assert words[0] == "hir", f"{line!r} is not executed"
            if words[1] in HEAVY:
                if not self.run_heavy:
                    return
                words += self.quick if words[1] == "reconstruct" else ()
            self._run([sys.executable, "-m", "hir_core.cli", *words[1:]])
        self.done.append(line)

    def _install(self, project: Path) -> None:
        """What an installer leaves that Python and hir look at: a path, and the metadata with its entry points."""
        document = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        info = self.site / f"{document['name'].replace('-', '_')}-{document['version']}.dist-info"
        info.mkdir()
        lines = ["Metadata-Version: 2.1", f"Name: {document['name']}", f"Version: {document['version']}"]
        lines += [f"Requires-Dist: {line}" for line in document.get("dependencies", [])]
        for extra, needed in document.get("optional-dependencies", {}).items():
            lines += [f"Provides-Extra: {extra}", *(f'Requires-Dist: {line}; extra == "{extra}"' for line in needed)]
        (info / "METADATA").write_text("\n".join(lines) + "\n", encoding="utf-8")
        table = document["entry-points"]["hir"]
        points = "".join(f"{name} = {target}\n" for name, target in table.items())
        (info / "entry_points.txt").write_text(f"[hir]\n{points}", encoding="utf-8")
        with (self.site / "paths.txt").open("a", encoding="utf-8") as paths:
            paths.write(f"{project}\n")

    def _run_any(self, arguments: list[str]) -> subprocess.CompletedProcess[str]:
        """`hir` with these arguments, whatever its exit code is."""
        return self._process([sys.executable, "-m", "hir_core.cli", *arguments])

    def _run(self, command: list[str]) -> str:
        done = self._process(command)
        assert done.returncode == 0, f"{command[1:]}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    def _process(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        listed = self.site / "paths.txt"
        projects = listed.read_text(encoding="utf-8").split() if listed.exists() else []
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(self.site), *projects, str(self.folder)])}
        return subprocess.run(command, capture_output=True, text=True, cwd=self.folder, env=environment)


def contains(whole: object, part: object) -> bool:
    """Whether every key of a nested table is there with its value."""
    if isinstance(part, dict):
        return isinstance(whole, dict) and all(key in whole and contains(whole[key], part[key]) for key in part)
    return whole == part
