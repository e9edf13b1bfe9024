"""Every table of the thesis beside what this project gets."""
