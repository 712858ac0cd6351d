"""Built-in commands: `hir batch`, `hir bench`, `hir card`, `hir delight`, `hir ui`, `hir view`."""
