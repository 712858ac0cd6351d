"""Studies of `hir batch`: fault injection, overhead, and a simulation of large batches."""
