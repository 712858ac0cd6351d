"""Initial values of a fit."""
