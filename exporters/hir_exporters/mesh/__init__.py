"""Meshes: files, simplification, tangents."""
