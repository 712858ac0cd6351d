"""batch.html."""
