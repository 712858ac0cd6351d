"""`hir ui`: a local page that checks and reconstructs captures."""
