"""The optimisation loop, its schedules and checkpoints, weighted energies, non-finite diagnostics."""
