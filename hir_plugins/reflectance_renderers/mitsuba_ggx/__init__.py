"""The reference renderer: path tracing of the BRDFs of `brdf_torch` with Mitsuba's ray tracer and Dr.Jit."""
