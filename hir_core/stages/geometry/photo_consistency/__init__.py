"""Moves the surface until photographs agree about it: residuals between neighbouring views, passes, candidates."""
