"""Logs of robots as one `Log`: foreign files are read safely, and files are written whole."""
