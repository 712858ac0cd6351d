"""Fits a mesh to masks, from coarse to fine, and its outlines alone at the end."""
