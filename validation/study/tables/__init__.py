"""The thesis' tables of tracked references beside this project's."""
