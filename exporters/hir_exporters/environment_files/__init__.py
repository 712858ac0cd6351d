"""Exporters of the light alone: lat-long images, prefiltered cubemaps, spherical harmonics."""
