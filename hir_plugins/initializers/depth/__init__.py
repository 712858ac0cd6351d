"""A first mesh from depths that a sensor measured."""
