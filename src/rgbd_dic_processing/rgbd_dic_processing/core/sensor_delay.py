"""A constant delay between the clocks of the two sensors, from what both saw of the camera's motion."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .geometry import Plane
from .panel_motion import PanelMotion, carried_back

Array = NDArray[np.float64]

REMEMBERED = 600  # ToF planes: half a minute at 20 Hz
SEARCHED_S, STEP_S = 0.2, 0.005  # delays that are tried: up to this, either way, at these steps
AROUND = 4  # steps on either side of the best one that the parabola is fitted to
LEAST_PLANES = 20
OUTLIER = 4.0  # distance from the mean, in units of what the planes scatter, beyond which one is left out
NEGLIGIBLE_S = 0.005  # a delay up to this is not warned about
LARGEST_U_S = 0.0025  # one that is known no better is not told
RIVAL = 4.0  # standard uncertainties within which all delays lie that fit nearly as well; else none is told
SURE = 3.0  # standard uncertainties that a delay must be away from zero for a warning
TOLD_AS = "delay of the ToF stamps [ms]"


@dataclass(frozen=True)
class SensorDelay:
    """By how much the stamps of the ToF frames are too late against those of the images.

    delay_s, u_s: it and its standard uncertainty [s]; NaN if it cannot be told, with the reason.
    planes: ToF frames that it rests on.
    """

    delay_s: float = math.nan
    u_s: float = math.nan
    planes: int = 0
    reason: str = ""

    @property
    def warning(self) -> str:
        """What a user should know; empty if the delay is negligible or not known."""
        if not abs(self.delay_s) > max(NEGLIGIBLE_S, SURE * self.u_s):
            return ""
        late = "late" if self.delay_s > 0 else "early"
        return (
            f"the stamps of the ToF frames are {abs(self.delay_s) * 1e3:.1f} ms too {late} "
            f"(standard uncertainty {self.u_s * 1e3:.1f} ms) against those of the images: correct the clocks, or add "
            f"{self.delay_s:.4f} to pairing.tof_delay_s"
        )

    def __str__(self) -> str:
        """For people, in milliseconds."""
        if self.reason:
            return f"unknown: {self.reason}"
        return f"{round(self.delay_s * 1e3, 1) + 0.0:.1f}, standard uncertainty {self.u_s * 1e3:.1f}"


class DelayEstimate:
    """Tries delays: with the right one, the ToF planes, carried to the reference, agree best with each other.

    The planes are carried back along the motion of the fixed region, from the moments that a delay puts them to. The
    weighted sum of squares of what they then scatter about their mean is a parabola near its least value; its vertex is
    the delay, its curvature the uncertainty, with the noise that the scatter itself shows.
    """

    def __init__(self) -> None:
        self._stamps: deque[int] = deque(maxlen=REMEMBERED)
        self._planes: deque[tuple[Array, Array]] = deque(maxlen=REMEMBERED)

    def add(self, depth_stamp_ns: int, plane: Plane) -> None:
        """The plane of the next ToF frame at its own moment; the same one again changes nothing.

        One that is earlier begins anew, as the clocks jumped back.
        """
        if self._stamps and depth_stamp_ns < self._stamps[-1]:
            self._stamps.clear()
            self._planes.clear()
        if not self._stamps or depth_stamp_ns != self._stamps[-1]:
            self._stamps.append(depth_stamp_ns)
            self._planes.append((plane.inverse_depth, np.linalg.inv(plane.inverse_depth_covariance())))

    def estimate(self, motion: PanelMotion) -> SensorDelay:
        """The delay as far as it is known now."""
        if len(self._stamps) < LEAST_PLANES:
            return SensorDelay(reason=f"{len(self._stamps)} ToF planes, at least {LEAST_PLANES} needed")
        steps = round(SEARCHED_S / STEP_S)
        tried = np.arange(-steps, steps + 1) * STEP_S
        times_ns = np.array(self._stamps) - np.rint(tried * 1e9).astype(np.int64)[:, None]
        pi, weights = (np.array(values) for values in zip(*self._planes, strict=True))
        R, t = motion.at(times_ns.ravel())
        carried = carried_back(np.tile(pi, (len(tried), 1)), R, t).reshape(len(tried), -1, 3)
        usable = np.isfinite(carried).all(axis=(0, 2))
        if usable.sum() < LEAST_PLANES:
            return SensorDelay(reason=f"{usable.sum()} ToF planes amid images, at least {LEAST_PLANES} needed")
        carried, weights = carried[:, usable], weights[usable]
        squared = _scatter(carried, weights)
        best = np.argmin(squared.sum(axis=1))
        kept = squared[best] <= OUTLIER**2 * max(3.0, np.median(squared[best]))
        squared = _scatter(carried[:, kept], weights[kept])
        total, count = squared.sum(axis=1), int(kept.sum())
        best = int(np.argmin(total))
        around = slice(best - AROUND, best + AROUND + 1)
        if not AROUND <= best < len(tried) - AROUND:
            reason = f"no delay up to {SEARCHED_S:g} s fits: the camera moved too little, or it is longer"
            return SensorDelay(planes=count, reason=reason)
        curved, sloped, _ = np.polyfit(tried[around], total[around], 2)
        noise = max(1.0, total[best] / (3 * count - 4))
        delay_s, u_s = float(-sloped / (2 * curved)), math.sqrt(noise / max(curved, 1e-9))
        rivals = tried[total <= total[best] + RIVAL**2 * noise]
        if u_s > LARGEST_U_S or np.abs(rivals - delay_s).max() > RIVAL * u_s + STEP_S:
            return SensorDelay(planes=count, reason="the camera moved too little, or too regularly, to tell")
        return SensorDelay(delay_s, u_s, count)


def _scatter(carried: Array, weights: Array) -> Array:
    """Squared distance (K, M) of planes (K, M, 3) from their weighted mean over M, under their weights (M, 3, 3)."""
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("mij,kmj->ik", weights, carried)).T
    apart = carried - mean[:, None]
    return np.einsum("kmi,mij,kmj->km", apart, weights, apart)
