"""The optimisation loop, weighted energies, checkpoints, non-finite diagnostics."""
