"""How contact and solver settings change the MuJoCo Husky."""
