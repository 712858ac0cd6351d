"""Standard errors of the fitted maps: by how much base colour, metalness and roughness depend on single photographs."""
