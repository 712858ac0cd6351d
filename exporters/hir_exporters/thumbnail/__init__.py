"""A small picture of the asset, for file browsers and asset libraries."""
