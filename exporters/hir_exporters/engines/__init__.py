"""What engines make of a written material."""
