"""Small made captures with known truth: shapes × materials × lights (docs/benchmarks.md)."""
