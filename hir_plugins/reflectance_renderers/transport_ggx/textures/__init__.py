"""The textures of a material: closed forms and fits at the resolution of texels."""
