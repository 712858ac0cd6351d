"""USD files as corners of triangles and a surface: those of the exporters, and those of other programs."""
