"""From a folder of photographs to a `Capture`: which reader, and what is wrong with the photographs."""
