"""Refuses untrusted USD files that reference layers or images outside their own folder."""

from __future__ import annotations

from pathlib import Path

from hir_exporters.errors import InputError
from hir_exporters.files.regular_files import refuse_special_file

MAX_LAYERS = 1000
"""Files that compose more layers are refused."""


def check_layers(path: Path) -> None:
    """Follows sublayers, references and payloads without composing them; raises `InputError` for one outside."""
    from pxr import Sdf

    pending, visited = [str(path)], {str(path)}
    while pending:
        layer = Sdf.Layer.FindOrOpen(pending.pop())
        if layer is None:
            continue  # composing the stage reports it
        for name in layer.GetCompositionAssetDependencies():
            target = layer.ComputeAbsolutePath(name)
            check_inside(path, target, name)
            if target not in visited:
                visited.add(target)
                pending.append(target)
        if len(visited) > MAX_LAYERS:
            raise InputError(f"{path} composes more than {MAX_LAYERS} layers; flatten it first")


def check_inside(path: Path, target: str, name: str) -> None:
    """Raises `InputError` unless `target` (a path, or a path into a package) is in the folder of `path`.

    Links are resolved. `name` is the reference as written, for the message.
    """
    from pxr import Ar

    outer = Ar.SplitPackageRelativePathOuter(target)[0]
    refuse_special_file(Path(outer))
    if not Path(outer).resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f"{path} names {name!r}, which is outside its folder; put the file beside it")
