"""Light and material at texels."""
