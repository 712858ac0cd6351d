"""The reflectance stage: its order, gradient fit, path-traced refinement, report."""
