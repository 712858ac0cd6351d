"""Image files, texture resizing and lookup, and texture-space rasterisation."""
