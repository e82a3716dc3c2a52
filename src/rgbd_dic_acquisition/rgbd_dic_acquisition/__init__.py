"""Sensors, recordings and the flight simulator. Nothing outside `nodes/` imports ROS."""
