"""Atomic file writes, function calls in subprocesses, and suppressed output of native libraries."""
