"""Measured depths as a term of the geometry fit."""
