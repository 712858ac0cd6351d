"""`hir batch`: reconstructs many captures on a Ray cluster. `Batch` in `scheduling.driver` is the entry point."""
