"""A mesh that already exists."""
