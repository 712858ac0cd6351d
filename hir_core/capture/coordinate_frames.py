"""The coordinate frames of a run as one object: source, asset, working (docs/conventions.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hir_core.capture.camera import Array
from hir_core.errors import InputError


@dataclass(frozen=True, eq=False)
class CoordinateFrames:
    """Similarities (4×4, float64) between the frames of a run.

    source: the axes and units of the capture's files. asset: +Y up, the scale of the initializers' result; exported
    files use it. working: the object's centre at the origin, its radius 1; all fits run in it.
    """

    asset_from_working: Array
    asset_from_source: Array

    @classmethod
    def identity(cls) -> CoordinateFrames:
        """Three frames that coincide."""
        return cls(np.eye(4), np.eye(4))

    @property
    def working_from_asset(self) -> Array:
        """4×4."""
        return np.linalg.inv(self.asset_from_working)

    @property
    def working_from_source(self) -> Array:
        """4×4."""
        return self.working_from_asset @ self.asset_from_source

    def as_document(self) -> dict[str, Any]:
        """Rows of both matrices, for JSON."""
        return {
            "asset_from_working": self.asset_from_working.tolist(),
            "asset_from_source": self.asset_from_source.tolist(),
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any], source: str) -> CoordinateFrames:
        """The inverse of `as_document`; `source` names the file in the `InputError` about malformed matrices."""
        try:
            frames = cls(
                *(
                    np.array(document[name], dtype=np.float64).reshape(4, 4)
                    for name in ("asset_from_working", "asset_from_source")
                )
            )
            singular = not np.isfinite(frames.working_from_asset).all()
        except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            raise InputError(f"{source}: the coordinate frames of the run are malformed ({error})") from error
        if singular:
            raise InputError(f"{source}: the coordinate frames of the run are not invertible")
        return frames
