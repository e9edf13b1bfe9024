"""How far planar models hold on slopes and rough ground."""
