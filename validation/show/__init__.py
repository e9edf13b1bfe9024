"""What tables, pictures and rerun recordings are put together from."""
