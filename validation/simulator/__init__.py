"""The MuJoCo robot: from its description to a compiled model that moves."""
