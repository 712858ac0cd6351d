"""Light transport: everything that is linear in the light."""
