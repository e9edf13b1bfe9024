"""Parts of tables, pictures and rerun recordings, and the base of all results."""
