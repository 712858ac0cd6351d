"""Built-in commands: `hir batch`, `hir bench`, `hir view`."""
