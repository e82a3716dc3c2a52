"""Attitude as aviation has it (north-east-down, forward-right-down) and as ROS has it (REP-103)."""

from __future__ import annotations

import math

Quaternion = tuple[float, float, float, float]  # w, x, y, z

NED_TO_ENU: Quaternion = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)
FLU_TO_FRD: Quaternion = (0.0, 1.0, 0.0, 0.0)


def enu_flu_from_ned_frd(q: Quaternion) -> Quaternion:
    """R_world_body from north-east-down and forward-right-down to east-north-up and forward-left-up.

    As mavros has it: NED_ENU_Q * q * AIRCRAFT_BASELINK_Q, each side turned by its static rotation.
    """
    return _product(_product(NED_TO_ENU, q), FLU_TO_FRD)


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Rz(yaw) Ry(pitch) Rx(roll); angles in radians, all finite."""
    about_x = (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0)
    about_y = (math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0)
    about_z = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return _product(_product(about_z, about_y), about_x)


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
