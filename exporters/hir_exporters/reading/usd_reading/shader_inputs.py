"""The values and connections of shader inputs, also through the inputs of a material or node graph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_exporters.errors import InputError

if TYPE_CHECKING:
    from pxr import Usd, UsdShade


def input_value(shader: UsdShade.Shader, name: str, path: Path, default: Any = None) -> Any:
    """The value of an input; `default` where it has none or is connected to a node."""
    from pxr import Usd, UsdShade

    attribute = _producing_attribute(shader, name, path)
    if attribute is None or UsdShade.Output.IsOutput(attribute):
        return default
    value = attribute.Get(Usd.TimeCode.EarliestTime())
    return default if value is None else value


def connected_node(shader: UsdShade.Shader, name: str, path: Path) -> tuple[UsdShade.Shader | None, str]:
    """The node that an input is connected to, and the name of its output; None where it is connected to none."""
    from pxr import UsdShade

    attribute = _producing_attribute(shader, name, path)
    if attribute is None or not UsdShade.Output.IsOutput(attribute):
        return None, ""
    return UsdShade.Shader(attribute.GetPrim()), str(UsdShade.Output(attribute).GetBaseName())


def _producing_attribute(shader: UsdShade.Shader, name: str, path: Path) -> Usd.Attribute | None:
    source = shader.GetInput(name)
    if not source:
        return None
    attributes = source.GetValueProducingAttributes()
    if not attributes and source.GetAttr().HasAuthoredConnections():
        target = source.GetAttr().GetConnections()[0]
        raise InputError(
            f"{path}: {source.GetAttr().GetPath()} is connected to {target}, which does not exist; connect it again"
        )
    return attributes[0] if attributes else None
