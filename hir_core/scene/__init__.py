"""The scene that is fitted, in torch: a mesh, its material, the light."""

from hir_core.scene.scene import CameraLamp, EnvironmentMap, Material, Mesh, Scene, Texture, Topology

__all__ = ["CameraLamp", "EnvironmentMap", "Material", "Mesh", "Scene", "Texture", "Topology"]
