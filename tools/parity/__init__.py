"""How exported files look in other engines, against our own path tracer: `make parity`."""
