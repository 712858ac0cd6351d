"""Environment light and its file formats."""
