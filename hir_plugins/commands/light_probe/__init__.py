"""`hir light-probe`: the light of a place from photographs of a mirror ball."""
