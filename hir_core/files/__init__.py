"""Documents and arrays on disk, shared by captures, scenes and runs."""
