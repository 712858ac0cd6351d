"""Cameras and points by structure from motion."""
