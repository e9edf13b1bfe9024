"""Files from outside and for outside: logs of robots as one `Log`, read safely and written whole."""
