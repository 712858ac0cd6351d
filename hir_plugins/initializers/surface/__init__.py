"""Surfaces from sampled fields: extraction, cleaning, vertex colours."""
