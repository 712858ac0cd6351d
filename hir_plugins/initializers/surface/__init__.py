"""A closed, coloured start surface from a sampled field."""
