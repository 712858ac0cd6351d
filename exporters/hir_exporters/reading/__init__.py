"""Reading written files back, and checking them."""
