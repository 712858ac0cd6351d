"""Files that appear complete or not at all; calls in processes of their own."""
