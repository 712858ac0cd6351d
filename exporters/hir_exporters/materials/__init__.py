"""BRDF models, and their conversion to what each format can say."""
