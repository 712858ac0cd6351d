"""The files of a COLMAP model."""
