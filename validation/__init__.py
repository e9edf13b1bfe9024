"""The shell: MuJoCo, files, pictures, command lines."""
