"""Laws, limits and recoveries; tolerances with their reasons in conftest.py."""
