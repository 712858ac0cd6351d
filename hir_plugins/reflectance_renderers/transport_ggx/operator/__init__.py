"""Everything that is linear in the light."""
