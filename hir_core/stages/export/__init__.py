"""The export stage: write, read back, verify."""
