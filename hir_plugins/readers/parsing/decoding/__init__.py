"""Photographs of all formats: decoding, colour profiles, the pixels of a file."""
