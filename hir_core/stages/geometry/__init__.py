"""The geometry stage: silhouettes, then photo-consistency."""
