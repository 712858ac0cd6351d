"""The lobes of pixels: their directions, what these see, and matrices of them."""
