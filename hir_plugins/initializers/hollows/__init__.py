"""Hollows that no outline shows: openings of the hull are sunk as deep as the photographs say."""
