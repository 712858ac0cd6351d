"""Images and texture maps."""
