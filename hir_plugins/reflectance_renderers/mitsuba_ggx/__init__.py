"""The reference renderer: path tracing by Mitsuba's ray tracer and Dr.Jit, exact against the formulas of brdf.py."""
