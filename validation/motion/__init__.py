"""What drives the plants and what they are compared with: a scenario or a recording."""
