"""Where a batch keeps its files."""
