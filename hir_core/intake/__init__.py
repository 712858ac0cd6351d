"""From a folder of photographs to a `Capture`: the choice of the reader, the capture check, the camera export."""
