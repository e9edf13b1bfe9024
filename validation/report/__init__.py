"""What every program gives: tables of rows, notes, pictures and recordings, put together in one `Report`."""
