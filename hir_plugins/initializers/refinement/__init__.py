"""Cameras that are a little wrong, refined from the photographs."""
