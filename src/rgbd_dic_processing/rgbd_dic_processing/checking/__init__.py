"""The checklist before take-off, `rgbd-dic check`: each check is a function that returns what it found."""
