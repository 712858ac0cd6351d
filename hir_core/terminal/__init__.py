"""Parts of a command line that the commands of hir_core and of plugins share."""
