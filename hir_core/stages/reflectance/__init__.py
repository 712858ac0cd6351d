"""The reflectance stage: model selection, gradient fit, path-traced refinement."""
