"""The pixels that a fit uses, and their batches."""
