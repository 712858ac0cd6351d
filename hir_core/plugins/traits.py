"""The traits of each kind of component and what each one promises; the contract tests check the promises."""

from __future__ import annotations

from collections.abc import Mapping

TRAITS: Mapping[str, Mapping[str, str]] = {
    "capture_reader": {
        "without_cameras": "reads photographs alone; asked after all readers that know cameras",
    },
    "mask_source": {
        "automatic": "used without being named in the settings, for photographs without a mask",
        "needs_cameras": "runs when every view has a camera",
        "needs_mesh": "runs after the initializers: `scene` holds their mesh, and every view has a camera",
        "reads_files": "`files` lists what it reads besides photographs, so that a change invalidates the cache",
    },
    "initializer": {
        "finds_cameras": "finds cameras for views that have none",
        "refines_cameras": "moves given cameras that are a little wrong; `hir check` announces it",
        "makes_surface": "returns a mesh that is the measured surface: half of its vertices within 3 % of the radius",
        "needs_cameras": "every view must have a camera",
        "needs_masks": "views must have masks",
        "needs_surface": "an initializer before it must have made a mesh, which it changes",
        "revises_mesh": "held-out views compare the mesh without its change; asked again with the fitted material and "
        "light, it returns the scene where they show nothing new",
        "needs_points": "the capture must have oriented points",
        "measures_points": "adds oriented points to the capture",
        "sets_scale": "scales the world to metres; where the settings give its options, an automatic chain contains it",
        "reads_files": "`files` lists what it reads besides photographs, so that a change invalidates the cache",
    },
    "geometry_renderer": {
        "differentiable": "areas and overlaps carry gradients to the positions",
    },
    "reflectance_renderer": {
        "material": "radiance carries gradients to the material's parameters",
        "environment": "radiance carries gradients to the light",
        "mesh": "radiance carries gradients to the positions",
        "stochastic": "values are noisy; the noise follows torch's random generator",
        "lambertian": "shades diffuse reflection alone: specular albedo and roughness have no effect",
        "solver": "`prepare` returns a `ReflectanceSolver`",
        "exposures": "the solver fits models with recorded and with fitted exposures (`ModelSpec.exposures`)",
        "camera_lamp": "shades the lamp of `EnvironmentMap`; a solver fits models with one (`ModelSpec.lamp`)",
        "takes": "the solver fits one light for each take of the capture (`View.take`)",
        "regularizers": "the solver minimises regularizers in its own fit (`ReflectanceSolver.with_terms`)",
        "reference": "unbiased; other renderers are compared with it",
    },
    "regularizer": {
        "differentiable": "the term carries gradients",
        "stop_gradient": "the gradient deliberately differs from that of the value",
        "signed": "the term may be negative; it is still bounded below",
        "rigid_invariant": "the value is invariant to rotation and translation",
        "scale_invariant": "the value is invariant to scaling",
        "material": "the term depends on the material; it belongs to the reflectance stage",
        "environment": "the term depends on the light",
        "vertex_maps": "the term also takes maps at the vertices of the mesh, (V, C); solvers fit such maps",
        "lagged": "the term is slow: a solver evaluates it every few steps, and uses its `near` in between",
    },
    "exporter": {
        "gltf": "`edit` receives the finished `pygltflib.GLTF2`",
        "usd": "`edit` receives the finished `pxr.Usd.Stage`",
        "environment": "writes the light only",
    },
}
