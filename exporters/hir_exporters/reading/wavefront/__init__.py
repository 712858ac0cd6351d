"""Reads Wavefront .obj files and their material libraries."""
