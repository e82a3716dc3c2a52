"""A recorded laboratory measured with one method, beside the truth of the very subsets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.simulator.laboratory import Laboratory

from ...core.displacement_field import DisplacementField
from ...core.pipeline import Measurement, Pipeline
from ...core.regions import CrackZones, Regions
from ...core.settings import ProcessingSettings
from .errors import rms
from .planes import RecordedPlanes, Settled
from .recording import load_recording, regions_file
from .regions import regions_of
from .scenes import Values, open_laboratory

Array = NDArray[np.float64]

THESIS_H_2D = "h_2d_thesis"
VARIANTS: dict[str, tuple[str, dict[str, dict[str, Any]]]] = {  # name -> method, and settings that it differs in
    THESIS_H_2D: ("h_2d", {"compensation": {"parting": False}}),
}
TOUCHING_PX = 3  # beyond half a subset, within which of the crack a subset sees both sides
HISTORY = ("time_s", "opening", "sliding", "u_opening", "u_sliding", "true_opening", "true_sliding", "map_x", "map_y")


def measure(
    folder: Path,
    laboratory: Values,
    recording: str,
    planes: Settled,
    method: str,
    region: str,
    settings: dict[str, dict[str, Any]] | None = None,
    roll_deg: dict[str, float] | None = None,
) -> dict[str, Any]:
    """Each image's crack opening and sliding, their standard uncertainties and their truth [mm], and the RMS error of
    the map [px]; NaN where it is invalid.

    Args:
        method: of the product, or one of `VARIANTS`.
        region: for the motion, one of `REGIONS`.
        settings: of the processing, by stage, where they differ from the defaults.
        roll_deg: axes that are drawn wrong: "crack" or "x_axis" -> angle [degrees].
    """
    lab = open_laboratory(laboratory)
    regions = _rolled(regions_of(lab, regions_file(folder, recording), region), roll_deg or {})
    material, rows, reasons = None, [], []
    method, settings = VARIANTS.get(method, (method, settings or {}))
    for time_s, measurement in replay(folder, lab, recording, planes, regions, (method,), settings):
        field, opening = measurement.field, measurement.opening
        if material is None:
            material = lab.material(field.centres_px.astype(float), lab.reference_s)
        if not opening.valid:
            reasons.append(f"{opening.status.name}: {opening.reason}")
        truth_m = lab.displacement(*material.T, time_s)
        values = (opening.opening_m, opening.sliding_m, opening.u_opening_m, opening.u_sliding_m)
        turn_rad = 0.0 if region == "half" else lab.turn_rad(time_s)
        values_mm = 1e3 * np.array([*values, *_true_jump_m(field, material, truth_m, turn_rad, regions.crack)])
        rows.append([time_s, *values_mm, *_map_rms_px(lab, field, truth_m, regions)])
    return {"reasons": reasons} | dict(zip(HISTORY, np.transpose(rows).tolist(), strict=True))


def replay(
    folder: Path,
    lab: Laboratory,
    recording: str,
    planes: Settled,
    regions: Regions,
    methods: tuple[str, ...],
    settings: dict[str, dict[str, Any]],
) -> Iterator[tuple[float, Measurement]]:
    """The pipeline on recorded fields and planes: the true time of each image, and what was measured in it."""
    stages = ProcessingSettings.from_mapping(settings)
    pipeline = Pipeline(lab.calibration, regions, stages, methods)
    pipeline.tracking, pipeline.planes = load_recording(folder, recording), RecordedPlanes(planes)
    times = {}
    for exposure in lab.exposures():
        if exposure.sensor == "camera":
            times[exposure.stamp_ns] = exposure.time_s
            measured = pipeline.add_image(exposure.stamp_ns, None)
        else:
            measured = pipeline.add_depth(exposure.stamp_ns, None)
        yield from ((times[one.field.stamp_ns], one) for one in measured)
    yield from ((times[one.field.stamp_ns], one) for one in pipeline.flush())


def _true_jump_m(
    field: DisplacementField, material: Array, truth_m: Array, turn_rad: float, crack: CrackZones
) -> Array:
    """(2,) opening and sliding of the very subsets that were found in the zones; of all, if nothing was measured.

    A region on both sides of the crack does not tell how the panel turns: what it gives is in axes that turn with the
    crack, by turn_rad since the reference.
    """
    found = np.isfinite(field.displacement_m[:, 0])
    zones = crack.members(field.centres_px.astype(float))
    left, right = (zone[found[zone]] if found[zone].any() else zone for zone in zones)
    apart = truth_m[right].mean(axis=0) - truth_m[left].mean(axis=0)
    x, y = material[right].mean(axis=0) - material[left].mean(axis=0)
    return apart[:2] - turn_rad * np.array([-y, x])


def _map_rms_px(lab: Laboratory, field: DisplacementField, truth_m: Array, regions: Regions) -> list[float]:
    """RMS over the panel of the error in x and in y, in pixels at the average distance."""
    pixel_m = lab.settings.motion.distance_m / lab.calibration.camera.fx
    error = map_error_m(field, truth_m, regions)
    return [rms(error[:, axis]) / pixel_m for axis in (0, 1)]


def map_error_m(field: DisplacementField, truth_m: Array, regions: Regions) -> Array:
    """(N, 2) measured minus true displacement, less the rigid motion in the plane that fits it best: how the panel as a
    whole moves is not told by images that are aligned on it. NaN for subsets that see both sides of the crack."""
    crack = regions.crack
    error = field.displacement_m[:, :2] - truth_m[:, :2]
    away_px = np.abs((field.centres_px - crack.point) @ crack.normal)
    error[away_px < field.subset_px / 2 + TOUCHING_PX] = np.nan
    known = np.flatnonzero(np.isfinite(error).all(axis=1))
    if not len(known):
        return error
    x, y = field.position_m[known].T
    zero, one = np.zeros_like(x), np.ones_like(x)
    design = np.block([[one[:, None], zero[:, None], -y[:, None]], [zero[:, None], one[:, None], x[:, None]]])
    motion, *_ = np.linalg.lstsq(design, error[known].T.ravel(), rcond=None)
    error[known] -= (design @ motion).reshape(2, -1).T
    return error


def _rolled(regions: Regions, roll_deg: dict[str, float]) -> Regions:
    """Regions whose crack direction or x axis is drawn turned; the zones stay."""

    def turn(angle_deg: float) -> Array:
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        return np.array([[c, -s], [s, c]])

    if "crack" in roll_deg:
        crack = replace(regions.crack, direction=turn(roll_deg["crack"]) @ regions.crack.direction)
        regions = replace(regions, crack=crack)
    if "x_axis" in roll_deg:
        middle = regions.x_axis.mean(axis=0)
        regions = replace(regions, x_axis=(regions.x_axis - middle) @ turn(roll_deg["x_axis"]).T + middle)
    return regions
