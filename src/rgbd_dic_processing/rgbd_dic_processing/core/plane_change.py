"""How the panel's plane moved in the camera since the reference, as the ToF sensor saw it.

The change is known far better than the plane itself: what the sensor gets wrong at one distance, it gets wrong a
centimetre farther as well, but for the slope of its error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .geometry import Plane
from .panel_motion import PanelMotion, Pose, pose_sensitivity
from .sensor_delay import SensorDelay
from .surface_estimate import DEFORMS_ALIKE_S

Array = NDArray[np.float64]

SLOPE_LENGTH_M = 0.1  # difference in distance over which the slope of the sensor's error changes
POINTS = 150  # of the panel, evenly taken, show how the error's slope moves a plane
NEAR_REFERENCE = 40  # ToF frames that tell where the reference's plane is, the first ones: two seconds at 20 Hz
ALIKE = 5  # of them that see the panel deformed alike
RATE_OVER_NS = 5_000_000  # time over which the rate of a plane is taken
DELAY_AT = (24, 28, 32, 40, 60, 80, 160)  # ToF frames after which the delay of their stamps is looked at
UNKNOWN_DELAY_S, LEAST_DELAY_S = 0.03, 0.002  # standard uncertainty of the stamps before it is known, and at least
UNUSED_M = 0.01  # standard uncertainty given to the distance: turns count alone, as a loaded panel bulges
LONGEST_AGE_S = 0.5  # of a ToF frame that still tells of an image


@dataclass(frozen=True)
class PlaneChange:
    """What the ToF sensor saw of the panel in the reference and in an image, both (3,) as n / -d [1/m].

    covariance: (3, 3), of `image` less `reference` carried to it by the camera's true motion.
    """

    reference: Array
    image: Array
    covariance: Array


@dataclass(frozen=True)
class _SeenPlane:
    """Of a ToF frame at its own moment. deformed: (3, 3), of `inverse_depth` in the reference, from deformation that
    was taken for the motion along which it is carried there."""

    stamp_ns: int
    plane: Plane
    deformed: Array


class PlaneChanges:
    """Carries the ToF planes to the reference along the poses of the images, as the images alone tell them.

    Where deformation is taken for motion, a carried plane is not where that of the reference is. That one is known from
    the first ToF frames, as far as the panel was not deformed yet.

    Args:
        rays: (N, 3), of the subsets in the reference; NaN for those that it lacks.
        slope: standard deviation of the slope of the ToF sensor's error over the distance.
        delay: tells, from how the panel moved, what is known of a delay of the ToF stamps.
    """

    def __init__(self, rays: Array, slope: float, delay: Callable[[PanelMotion], SensorDelay]):
        known = rays[np.isfinite(rays).all(axis=1)]
        self._rays = known[:: max(1, len(known) // POINTS)]
        self._slope, self._delay = slope, delay
        self._motion = PanelMotion()
        self._waiting: dict[int, Plane] = {}
        self._newest_ns, self._count = -1, 0
        self._late_s, self._u_late_s = 0.0, UNKNOWN_DELAY_S
        self._first: list[_SeenPlane] = []
        self._weight, self._weighed = np.zeros((3, 3)), np.zeros(3)
        self._latest: tuple[int, Plane] | None = None

    def add(self, stamp_ns: int, plane: Plane) -> None:
        """The plane of the next ToF frame at its own moment; the same one again, or an earlier one, changes nothing."""
        if stamp_ns > self._newest_ns:
            self._newest_ns = stamp_ns
            self._waiting[stamp_ns] = plane

    def at_image(self, stamp_ns: int, pose: Pose, likely: Array, possible: Array) -> PlaneChange | None:
        """For the next image; None as long as no ToF frame tells.

        Args:
            pose: from the image alone.
            likely, possible: (6, 6), its covariances from deformation that was taken for motion: how far it probably is
                off, and how far it may be.
        """
        self._motion.add(stamp_ns, pose)
        for moment in [moment for moment in self._waiting if moment <= stamp_ns]:
            self._take_in(moment, self._waiting.pop(moment), pose, possible)
        if self._latest is None:
            return None
        age_s = (stamp_ns - self._latest[0]) * 1e-9 + self._late_s
        if abs(age_s) > LONGEST_AGE_S:
            return None
        reference = Plane.from_inverse_depth(np.linalg.solve(self._weight, self._weighed), np.linalg.inv(self._weight))
        image, expected = self._latest[1].moved(*pose), reference.moved(*pose)
        noise = image.inverse_depth_covariance() + expected.inverse_depth_covariance()
        since = _of_plane(reference, pose, likely) * (age_s / DEFORMS_ALIKE_S) ** 2
        nearer = expected.inverse_depth / -expected.d * UNUSED_M
        change = expected.inverse_depth - reference.inverse_depth
        calibration = np.square(self._slope * change).sum() * np.eye(3)
        covariance = noise + since + self._of_sensor(reference, pose) + calibration + np.outer(nearer, nearer)
        return PlaneChange(reference.inverse_depth, image.inverse_depth, covariance)

    def _take_in(self, stamp_ns: int, plane: Plane, pose: Pose, possible: Array) -> None:
        """A ToF frame just before an image of this pose."""
        self._count += 1
        if self._count in DELAY_AT:
            self._look_at_delay()
        carried = self._carried(stamp_ns, plane)
        if carried is None:
            return
        self._latest = stamp_ns, carried
        if len(self._first) < NEAR_REFERENCE:
            seen = carried.moved(*pose).inverse_depth
            deformed = Plane.from_inverse_depth(seen, _of_plane(carried, pose, possible)).moved(*_back(pose))
            self._first.append(_SeenPlane(stamp_ns, plane, deformed.inverse_depth_covariance()))
            self._average(carried, self._first[-1].deformed)

    def _average(self, carried: Plane, deformed: Array) -> None:
        """One more plane for that of the reference: a panel that has deformed tells little."""
        weight = np.linalg.inv(carried.inverse_depth_covariance() + ALIKE * deformed)
        self._weight, self._weighed = self._weight + weight, self._weighed + weight @ carried.inverse_depth

    def _look_at_delay(self) -> None:
        delay = self._delay(self._motion)
        if delay.reason:
            return
        self._late_s, self._u_late_s = delay.delay_s, max(delay.u_s, LEAST_DELAY_S)
        again = [(self._carried(seen.stamp_ns, seen.plane), seen.deformed) for seen in self._first]
        if any(carried is not None for carried, _ in again):
            self._weight, self._weighed = np.zeros((3, 3)), np.zeros(3)
            for carried, deformed in again:
                if carried is not None:
                    self._average(carried, deformed)

    def _carried(self, stamp_ns: int, plane: Plane) -> Plane | None:
        """A ToF plane in the reference; None if the motion at its moment is not known."""
        moment_ns = stamp_ns - round(self._late_s * 1e9)
        R, t = self._motion.at(moment_ns + RATE_OVER_NS * np.array([0, -1, 1]))
        known = np.isfinite(t).all(axis=1)
        if not known[0] or not known[1:].any():
            return None
        now, other = (plane.moved(*_back((R[i], t[i]))) for i in (0, 1 if known[1] else 2))
        rate = (other.inverse_depth - now.inverse_depth) / (RATE_OVER_NS * 1e-9)
        late = np.outer(rate, rate) * self._u_late_s**2
        return Plane.from_inverse_depth(now.inverse_depth, now.inverse_depth_covariance() + late)

    def _of_sensor(self, reference: Plane, pose: Pose) -> Array:
        """(3, 3): of the change of the plane, in the image, from the sensor's error along its rays.

        The error is a random function of the distance with the correlation exp(-D^2 / 2 L^2), so that its slope has the
        standard deviation `slope`.
        """
        before = reference.points(self._rays)
        after = before @ pose[0].T + pose[1]
        seen = reference.moved(*pose).inverse_depth
        carries = np.column_stack([_moved(reference.inverse_depth, step, pose) for step in np.eye(3)])
        by_error = np.hstack([-carries @ _by_error(before, reference.inverse_depth), _by_error(after, seen)])
        distance = np.linalg.norm(np.concatenate([before, after]), axis=1)
        correlation = np.exp(-0.5 * np.square((distance[:, None] - distance) / SLOPE_LENGTH_M))
        return (self._slope * SLOPE_LENGTH_M) ** 2 * by_error @ correlation @ by_error.T


def _back(pose: Pose) -> Pose:
    return pose[0].T, -pose[0].T @ pose[1]


def _of_plane(plane: Plane, pose: Pose, covariance: Array) -> Array:
    """(3, 3): what the covariance (6, 6) of a pose gives to `inverse_depth` of a plane that is carried by it."""
    by_pose = pose_sensitivity(plane.inverse_depth, pose)
    return by_pose @ covariance @ by_pose.T


def _moved(pi: Array, step: Array, pose: Pose) -> Array:
    """(3,): by how much the plane pi (3,), carried by a pose, moves with a step of it."""
    q, s = pose[0] @ pi, pose[0] @ step
    length = 1 + q @ pose[1]
    return s / length - q * (s @ pose[1]) / length**2


def _by_error(points: Array, pi: Array) -> Array:
    """(3, M): by how much the plane pi through points (M, 3) moves with an error of each along its ray."""
    z = points[:, 2]
    scaled = points * z[:, None]  # the fit weighs a point's 1/z by z^4
    gain = -z * (points @ pi) / np.linalg.norm(points, axis=1)
    return np.linalg.solve(scaled.T @ scaled, scaled.T * gain)
