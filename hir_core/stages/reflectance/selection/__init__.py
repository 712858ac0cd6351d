"""Model selection of the reflectance stage: hypotheses, refinements and shape, decided by held-out views."""
