"""Captures, meshes and references that the suites measure with."""
