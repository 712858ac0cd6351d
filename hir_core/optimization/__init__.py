"""The optimisation loop, its schedules and checkpoints, weighted energies, linear maps, non-finite diagnostics."""
