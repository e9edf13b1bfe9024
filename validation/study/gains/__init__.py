"""Every shipped set of gains on every reference."""
