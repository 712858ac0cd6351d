"""glTF extensions that are JSON alone: one module for each."""
