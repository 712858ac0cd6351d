"""Accessors, nodes and required extensions of glTF files, compressed and not."""
