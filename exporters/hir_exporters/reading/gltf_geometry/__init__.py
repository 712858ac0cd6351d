"""Accessors and nodes of glTF files, compressed and not, as arrays."""
