"""Light and material fitted at vertices."""
