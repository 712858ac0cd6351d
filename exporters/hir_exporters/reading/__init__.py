"""Reads files back: to verify exports, to import meshes and lights, and to run external validators."""
