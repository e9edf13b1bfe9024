"""Logs of robots: files in, columns on one clock, files out."""
