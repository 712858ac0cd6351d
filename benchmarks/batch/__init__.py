"""`hir batch`: a cluster that loses workers, overhead, and a model of large batches."""
