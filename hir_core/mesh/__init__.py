"""Operations on triangle meshes and their textures."""
