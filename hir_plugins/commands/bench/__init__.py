"""`hir bench`: seconds, memory and error of every component at growing sizes, each beside its slow reference."""
