"""Types of Dr.Jit arrays and Mitsuba objects, for annotations.

They are `Any`, because the concrete types belong to a Mitsuba variant (`llvm_ad_rgb`, `cuda_ad_rgb`) that is chosen at
run time; a type checker sees only the variant that was active when Mitsuba's stubs were made.
"""

from __future__ import annotations

from typing import Any, TypeAlias

DrJitArray: TypeAlias = Any
"""A Dr.Jit array of any kind: `mi.Float`, `mi.UInt32`, `mi.Bool`, `mi.Vector3f`, `mi.Color3f`, `mi.Matrix3f`, …"""

MitsubaObject: TypeAlias = Any
"""An object of Mitsuba: a scene, an interaction, a texture, a context of a BSDF."""
