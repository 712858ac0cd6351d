"""Cached light transport for frozen geometry: rays are traced once, every step after is linear algebra."""
