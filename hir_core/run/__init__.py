"""What surrounds the stages: run directory, cache, progress, memory plan, machine."""
