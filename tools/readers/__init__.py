"""Which third-party readers read which exported file: `python -m readers` from `tools` (`make readers`)."""
