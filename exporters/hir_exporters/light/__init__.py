"""Environment light: lat-long images, spherical harmonics, prefiltered cubemaps, and their file formats."""
