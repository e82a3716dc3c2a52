"""From images and ToF planes to the opening of a crack. Only `nodes/` and `graph.py` know ROS."""
