"""Renders for measuring and showing: the reference renderer, lights from files, photographs to compare with."""
