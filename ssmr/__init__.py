"""Models, friction laws, metrics: numbers in, numbers out."""
