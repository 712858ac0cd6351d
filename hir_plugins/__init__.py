"""Everything built into `hir`, found through the same entry points as anybody's plugin."""
