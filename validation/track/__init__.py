"""Follow a reference with a controller around any plant."""
