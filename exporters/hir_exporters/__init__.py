"""Asset SDK of `hir`: physical assets in, glTF, USD and environment files out. Needs neither torch nor mitsuba."""
