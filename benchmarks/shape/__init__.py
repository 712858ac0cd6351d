"""Made captures with true meshes: convex, concave, thin and holed objects × four materials (docs/benchmarks.md)."""
