"""Other people's robots and simulations: read, examined and mended."""
