"""What suites give: rows, tables, plots."""
