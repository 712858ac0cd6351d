"""Other programs on the same tasks: stock Mitsuba, its projective integrator, colour mapping of open3d."""
