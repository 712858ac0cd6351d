"""Screened Poisson surface reconstruction."""
