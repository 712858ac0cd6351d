"""glTF documents of any program: their accessors, textures and material, and what an asset cannot represent."""
