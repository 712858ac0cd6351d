"""Results of benchmarks: rows, tables, plots and comparisons."""
