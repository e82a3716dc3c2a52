"""Removal of the camera's motion: one solver a file, one result type each of two kinds (`motion.py`)."""
