"""A USD file of strangers may compose and show nothing that lies outside of its own folder."""

from __future__ import annotations

from pathlib import Path

from hir_exporters.errors import InputError

MOST_LAYERS = 1000
"""A file that composes more is refused."""


def check_layers(path: Path) -> None:
    """Follows sublayers, references and payloads without composing them; one that leads out is an `InputError`."""
    from pxr import Sdf

    waiting, seen = [str(path)], {str(path)}
    while waiting:
        layer = Sdf.Layer.FindOrOpen(waiting.pop())
        if layer is None:
            continue  # composing it says so, too
        for name in layer.GetCompositionAssetDependencies():
            target = layer.ComputeAbsolutePath(name)
            check_inside(path, target, name)
            if target not in seen:
                seen.add(target)
                waiting.append(target)
        if len(seen) > MOST_LAYERS:
            raise InputError(f"{path} composes more than {MOST_LAYERS} layers; flatten it first")


def check_inside(path: Path, target: str, name: str) -> None:
    """`target`, an absolute path or one into a package, lies in the folder of `path`, also after links are followed."""
    from pxr import Ar

    outer = Ar.SplitPackageRelativePathOuter(target)[0]
    if not Path(outer).resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f"{path} names {name!r}, which lies outside of its folder; put the file beside it")
