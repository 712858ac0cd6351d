"""BRDF models, their conversion to the material parameters of each format, and the error of each conversion."""
