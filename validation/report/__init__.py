"""The result of every program: tables, notes, pictures and recordings in one `Report`."""
