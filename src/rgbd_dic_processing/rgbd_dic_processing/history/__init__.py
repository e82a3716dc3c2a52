"""A run's opening over time: beside a reference of another rate and clock, its spectrum, and what its zones do to it.

Without ROS; arrays go in, frozen dataclasses come out (docs/history.md; thesis 4.4.2).
"""
