"""Both cameras, the transform between them and every board's pose, adjusted together, with their covariance.

OpenCV calibrates each sensor alone and projects with derivatives; Gauss and Newton's method then minimises the
reprojection errors of all images of both sensors at once. Every image has its own noise, estimated from its residuals
(variance components by Förstner's method: squared residuals over redundancy), because a slanted or distant board is
located less well than a near one. The covariance is the inverse of the normal matrix with that noise, widened where the
jackknife over the boards (each left out in turn) scatters more: corners of one board can err together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .alone import calibrate_alone, relative_poses
from .board import Board
from .estimate import Estimate, make_estimate
from .model import LENS, Layout, Model, View
from .normal_equations import ImageEquations, jackknife, solve

Array = NDArray[np.float64]

REWEIGHTINGS = 4


def adjust(views: Sequence[View], board: Board, models: dict[str, Model]) -> Estimate:
    """All parameters from all images together.

    Args:
        views: each seen by at least one sensor; with a ToF sensor, some by both.
        models: `camera`, and `tof` if there is one.

    Raises:
        CalibrationError: there is no solution.
    """
    layout = Layout(models, len(views))
    images = [
        ImageEquations(i, sensor, view.of(sensor), board.corners_m[view.of(sensor).ids])
        for i, view in enumerate(views)
        for sensor in models
        if view.of(sensor) is not None
    ]
    x = _start(views, board, layout)
    for _ in range(REWEIGHTINGS):
        x, covariance = solve(x, images, layout)
        for image in images:
            image.reweigh(x, covariance, layout)
    x, covariance = solve(x, images, layout)
    wider = np.maximum(1, jackknife(x, images, layout) / np.sqrt(np.diag(covariance)))
    covariance = covariance * np.outer(wider, wider)
    fits = {(image.view, image.sensor): image.fit(x, layout) for image in images}
    return make_estimate(layout, x, covariance, fits, len(views))


def _start(views: Sequence[View], board: Board, layout: Layout) -> Array:
    """Parameters from each sensor alone."""
    x, poses = np.zeros(layout.size), {}
    for sensor, model in layout.models.items():
        seen = [i for i, view in enumerate(views) if view.of(sensor) is not None]
        camera, found = calibrate_alone([views[i].of(sensor) for i in seen], board, model)
        x[layout.lens[sensor]] = np.array([getattr(camera, name) for name in LENS])[model.free]
        poses[sensor] = dict(zip(seen, found, strict=True))
    R_tc, t_tc = np.eye(3), np.zeros(3)
    if "tof" in layout.models:
        both = [i for i in poses["camera"] if i in poses["tof"]]
        R_tc, t_tc, *_ = relative_poses(*([poses[s][i] for i in both] for s in ("camera", "tof")))
        x[layout.transform] = np.concatenate([Rotation.from_matrix(R_tc).as_rotvec(), t_tc])
    for i in range(len(views)):
        if i in poses["camera"]:
            R, t = poses["camera"][i]
        else:
            R, t = poses["tof"][i]
            R, t = R_tc.T @ R, R_tc.T @ (t - t_tc)
        x[layout.pose(i)] = np.concatenate([Rotation.from_matrix(R).as_rotvec(), t])
    return x
