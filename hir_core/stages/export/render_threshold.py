"""The PSNR that the render of an exported file must reach."""

from typing import Final

GOOD_PSNR: Final = 40.0
"""dB over the object's pixels against the render of the fitted scene; below it, an export has a warning."""
