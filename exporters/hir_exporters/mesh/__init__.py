"""Meshes: PLY, simplification, tangents, normal baking, welding."""
