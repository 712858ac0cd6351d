"""Other programs on the same tasks: stock Mitsuba, its projective integrator, open3d's colour mapping."""
