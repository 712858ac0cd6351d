"""The suites of `hir bench`: one function each that yields rows."""
