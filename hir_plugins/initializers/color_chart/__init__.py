"""Initializer: the light that a ColorChecker beside the object shows."""
