"""Bilateral terms."""
