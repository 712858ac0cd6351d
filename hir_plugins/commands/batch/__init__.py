"""Many captures on Ray: each a chain of tasks that resume the same run, staged through a local cache.

`Batch` in `hir_plugins.commands.batch.scheduling.driver` is what `hir batch` runs.
"""
