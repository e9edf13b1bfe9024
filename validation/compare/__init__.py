"""Drive every plant with the same commands and compare each with a reference."""
