"""batch.html: the summary page of a batch."""
