"""Occlusion boundaries inside the outline: where one part of the object hides another, such as the rim of a vessel."""
