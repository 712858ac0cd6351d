"""A third party's plugin for hir."""
