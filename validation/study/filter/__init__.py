"""How fast dead reckoning drifts."""
