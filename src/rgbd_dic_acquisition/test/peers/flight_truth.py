"""What the simulated autopilots fly: a function of host time alone, so that attitude and stamp check each other."""

from __future__ import annotations

ROLL_RAD, PITCH_RAD = 0.1, -0.2
YAW_RATE_RAD_S = 0.5
EPOCH_NS = 1_700_000_000 * 10**9


def yaw_rad(host_ns: int) -> float:
    """Of the nose from north over east [rad], growing with time."""
    return YAW_RATE_RAD_S * ((host_ns - EPOCH_NS) % (10**9 * 1000)) * 1e-9
