"""`hir view`: a page that shows an asset in three.js."""
