"""The result of every program: tables of rows, notes, pictures and recordings, put together in one `Report`."""
