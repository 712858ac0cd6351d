"""Shading formulas of engines, to predict how they render an exported material."""
