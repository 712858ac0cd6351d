"""The scene that is fitted, in torch: a mesh, its material, the light."""

from hir_core.scene.scene import EnvironmentMap, Material, Mesh, Scene, Texture, Topology

__all__ = ["EnvironmentMap", "Material", "Mesh", "Scene", "Texture", "Topology"]
