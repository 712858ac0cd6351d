"""The contracts, one module for each kind; `hir_core.testing.running` imports them."""
