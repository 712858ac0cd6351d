"""The words of `Component.traits`: for each kind, what a trait promises. The contract tests check the promises."""

from __future__ import annotations

from collections.abc import Mapping

TRAITS: Mapping[str, Mapping[str, str]] = {
    "capture_reader": {},
    "mask_source": {
        "automatic": "asked without being named, where photographs have no mask of their own",
        "needs_cameras": "asked once every view has a camera",
        "reads_files": "`files` names what it reads beyond the photographs, so that a changed file is noticed",
    },
    "initializer": {
        "finds_cameras": "gives cameras to views that have none",
        "makes_surface": "returns a scene with a mesh",
        "needs_cameras": "every view must have a camera",
        "needs_masks": "views must have masks",
        "needs_points": "the capture must have oriented points",
        "measures_points": "leaves oriented points in the capture",
        "reads_files": "`files` names what it reads beyond the photographs, so that a changed file is noticed",
    },
    "geometry_renderer": {
        "differentiable": "areas and overlaps carry gradients to the positions",
    },
    "reflectance_renderer": {
        "material": "radiance carries gradients to the material's parameters",
        "environment": "radiance carries gradients to the light",
        "mesh": "radiance carries gradients to the positions",
        "stochastic": "values have noise, which follows torch's generator",
        "solver": "`prepare` returns a `ReflectanceSolver`",
        "reference": "unbiased: what every other renderer is compared with",
    },
    "regularizer": {
        "differentiable": "the term carries gradients",
        "stop_gradient": "the gradient is on purpose not that of the value",
        "signed": "the term may be negative; it is still bounded below",
        "rigid_invariant": "turning and moving the scene changes nothing",
        "scale_invariant": "scaling the scene changes nothing",
        "material": "the term looks at the material; it belongs to the reflectance stage",
        "environment": "the term looks at the light",
    },
    "exporter": {
        "gltf": "`edit` is handed the finished `pygltflib.GLTF2`",
        "usd": "`edit` is handed the finished `pxr.Usd.Stage`",
        "environment": "the light alone is written",
    },
}
