"""Calibration of both sensors from images of a board: `rgbd-dic calibrate`. No ROS in here."""
