"""The paper's experiments on our captures: `python -m benchmarks.experiments`, one resumable job a cell."""
