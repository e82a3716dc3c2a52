"""Messages of rgbd_dic_msgs <-> what the core computes: the only place that knows both.

Reading works on any object with the fields of the message, so it serves bags too; creating takes the factory
`make(typename, **fields)` of the node or of the bag.
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.messages import (
    MessageFactory,
    header_message,
    image_from_message,
    image_message,
    stamp_message,
    stamp_to_ns,
)

from ..core.crack import CrackOpening
from ..core.curvature import Curvature
from ..core.displacement_field import DisplacementField
from ..core.geometry import Plane
from ..core.nearest_attitude import Attitude
from ..core.opening_log import Openings
from ..core.pairing import FramePair
from ..core.plane import PlaneEstimate
from ..core.regions_file import entries_of_text, regions_of, text_of
from ..core.search import SeedSource
from ..core.status import FrameStatus
from ..core.subset_field import Reference, SubsetField

PANEL_FRAME = "panel"
METHOD_CODES = {"h_3d": 0, "h_2d": 1, "pc_3d": 2, "h_pose": 3, "h_joint": 4}  # rgbd_dic_msgs/Method
METHOD_NAMES = {code: name for name, code in METHOD_CODES.items()}


def frame_pair_message(make: MessageFactory, pair: FramePair, frame_id: str, attitude: Attitude | None = None) -> Any:
    """attitude: of the vehicle, nearest in time to the image; None if there is none."""
    stamp_ns = attitude.stamp_ns if attitude else 0
    turn = attitude.orientation_xyzw if attitude else (np.nan,) * 4
    return make(
        "rgbd_dic_msgs/msg/FramePair",
        header=header_message(make, pair.stamp_ns, frame_id),
        status=_status(make, pair.status),
        depth_stamp=stamp_message(make, pair.depth_stamp_ns or 0),
        depth_offset=float(pair.depth_offset_s),
        reason=pair.reason,
        attitude_stamp=stamp_message(make, stamp_ns),
        attitude_offset=(pair.stamp_ns - stamp_ns) * 1e-9 if attitude else np.nan,
        attitude=make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn, strict=True))),
    )


def frame_pair_from_message(msg: Any) -> FramePair:
    paired = msg.status.value == FrameStatus.OK
    return FramePair(stamp_to_ns(msg.header.stamp), stamp_to_ns(msg.depth_stamp) if paired else None, msg.reason)


def plane_message(make: MessageFactory, estimate: PlaneEstimate, frame_id: str) -> Any:
    plane = estimate.plane
    coefficients = np.full(4, np.nan) if plane is None else np.append(plane.normal, plane.d)
    covariance = np.full(16, np.nan) if plane is None else plane.covariance.ravel()
    systematic = np.full(16, np.nan) if estimate.systematic is None else estimate.systematic.ravel()
    bow = estimate.curvature or Curvature(np.full(3, np.nan), np.full((3, 3), np.nan), np.full((3, 3), np.nan))
    return make(
        "rgbd_dic_msgs/msg/PlaneStamped",
        header=header_message(make, estimate.stamp_ns, frame_id),
        status=_status(make, estimate.status),
        reason=estimate.reason,
        plane=make("shape_msgs/msg/Plane", coef=coefficients),
        covariance=covariance,
        systematic_covariance=systematic,
        points=int(estimate.points),
        inliers=int(estimate.inliers),
        residual_rms=float(estimate.residual_rms_m),
        step=float(estimate.step_m),
        u_step=float(estimate.u_step_m),
        curvature=bow.values,
        curvature_covariance=bow.covariance.ravel(),
        curvature_systematic_covariance=bow.systematic.ravel(),
    )


def plane_from_message(msg: Any) -> PlaneEstimate:
    status = FrameStatus(msg.status.value)
    coefficients = np.array(msg.plane.coef, float)
    plane = Plane(coefficients[:3], float(coefficients[3]), np.array(msg.covariance, float).reshape(4, 4))
    systematic = np.array(msg.systematic_covariance, float).reshape(4, 4)
    bow = Curvature(
        np.array(msg.curvature, float),
        np.array(msg.curvature_covariance, float).reshape(3, 3),
        np.array(msg.curvature_systematic_covariance, float).reshape(3, 3),
    )
    return PlaneEstimate(
        stamp_to_ns(msg.header.stamp),
        status,
        msg.reason,
        plane if status == FrameStatus.OK else None,
        int(msg.points),
        int(msg.inliers),
        float(msg.residual_rms),
        float(msg.step),
        float(msg.u_step),
        None if np.isnan(systematic).any() else systematic,
        None if np.isnan(bow.values).any() else bow,
    )


def reference_message(make: MessageFactory, reference: Reference, frame_id: str) -> Any:
    return make(
        "rgbd_dic_msgs/msg/Reference",
        header=header_message(make, reference.stamp_ns, frame_id),
        image=image_message(make, reference.stamp_ns, frame_id, reference.image, "mono8"),
        subset_size=int(reference.subset_size),
        step=int(reference.step),
        x=reference.centres_px[:, 0],
        y=reference.centres_px[:, 1],
        drawn_x=reference.drawn_px[:, 0],
        drawn_y=reference.drawn_px[:, 1],
        homography=reference.homography.ravel(),
        regions=text_of(reference.regions.entries) if reference.regions and reference.regions.entries else "",
    )


def reference_from_message(msg: Any) -> Reference:
    return Reference(
        stamp_to_ns(msg.header.stamp),
        image_from_message(msg.image),
        np.column_stack([_array(msg.x), _array(msg.y)]),
        int(msg.subset_size),
        int(msg.step),
        np.column_stack([_array(msg.drawn_x), _array(msg.drawn_y)]),
        np.array(msg.homography, float).reshape(3, 3),
        regions_of(entries_of_text(msg.regions)) if msg.regions else None,
    )


def subset_field_message(make: MessageFactory, field: SubsetField, frame_id: str) -> Any:
    return make(
        "rgbd_dic_msgs/msg/SubsetField",
        header=header_message(make, field.stamp_ns, frame_id),
        reference_stamp=stamp_message(make, field.reference_stamp_ns),
        keyframe_stamp=stamp_message(make, field.keyframe_stamp_ns),
        image_received=stamp_message(make, field.image_received_ns),
        status=_status(make, field.status),
        reason=field.reason,
        seed_source=int(field.seed_source),
        subset_size=float(field.subset_px),
        homography=field.homography.ravel(),
        x=field.moved_px[:, 0],
        y=field.moved_px[:, 1],
        sigma_x=field.sigma_px[:, 0],
        sigma_y=field.sigma_px[:, 1],
        zncc=field.zncc,
        iterations=field.iterations,
        subset_status=field.subset_status,
    )


def subset_field_from_message(msg: Any) -> SubsetField:
    return SubsetField(
        stamp_to_ns(msg.header.stamp),
        stamp_to_ns(msg.reference_stamp),
        stamp_to_ns(msg.keyframe_stamp),
        FrameStatus(msg.status.value),
        msg.reason,
        SeedSource(msg.seed_source),
        float(msg.subset_size),
        np.array(msg.homography, float).reshape(3, 3),
        np.column_stack([_array(msg.x), _array(msg.y)]),
        np.column_stack([_array(msg.sigma_x, "f4"), _array(msg.sigma_y, "f4")]),
        _array(msg.zncc, "f4"),
        _array(msg.iterations, "u1"),
        _array(msg.subset_status, "u1"),
        stamp_to_ns(msg.image_received),
    )


def displacement_field_message(make: MessageFactory, field: DisplacementField) -> Any:
    axes = ("x", "y", "z")
    return make(
        "rgbd_dic_msgs/msg/DisplacementField",
        header=header_message(make, field.stamp_ns, PANEL_FRAME),
        reference_stamp=stamp_message(make, field.reference_stamp_ns),
        keyframe_stamp=stamp_message(make, field.keyframe_stamp_ns),
        image_received=stamp_message(make, field.image_received_ns),
        method=make("rgbd_dic_msgs/msg/Method", value=METHOD_CODES[field.method]),
        status=_status(make, field.status),
        reason=field.reason,
        depth_offset=float(field.depth_offset_s),
        subset_size=float(field.subset_px),
        x_px=field.centres_px[:, 0],
        y_px=field.centres_px[:, 1],
        x=field.position_m[:, 0],
        y=field.position_m[:, 1],
        **{f"d{axis}": field.displacement_m[:, i] for i, axis in enumerate(axes)},
        **{f"sigma_d{axis}": field.sigma_m[:, i] for i, axis in enumerate(axes)},
        compensation_modes=field.modes.ravel(),
        mode_sources=field.mode_sources,
        zone_coupling=field.zone_coupling.ravel(),
        scale_uncertainty=float(field.scale_uncertainty),
        u_step=float(field.u_step_m),
        residual=float(field.residual_px),
    )


def displacement_field_from_message(msg: Any) -> DisplacementField:
    return DisplacementField(
        stamp_to_ns(msg.header.stamp),
        stamp_to_ns(msg.reference_stamp),
        stamp_to_ns(msg.keyframe_stamp),
        METHOD_NAMES[msg.method.value],
        FrameStatus(msg.status.value),
        msg.reason,
        float(msg.depth_offset),
        float(msg.subset_size),
        np.column_stack([_array(msg.x_px, "f4"), _array(msg.y_px, "f4")]),
        np.column_stack([_array(msg.x), _array(msg.y)]),
        np.column_stack([_array(msg.dx), _array(msg.dy), _array(msg.dz)]),
        np.column_stack([_array(msg.sigma_dx, "f4"), _array(msg.sigma_dy, "f4"), _array(msg.sigma_dz, "f4")]),
        _array(msg.compensation_modes).reshape(-1, 3, 6),
        _array(msg.mode_sources, "u1"),
        _array(msg.zone_coupling).reshape(-1, 2, 3),
        float(msg.scale_uncertainty),
        float(msg.u_step),
        float(msg.residual),
        stamp_to_ns(msg.image_received),
    )


def crack_opening_message(make: MessageFactory, opening: CrackOpening) -> Any:
    return make(
        "rgbd_dic_msgs/msg/CrackOpening",
        header=header_message(make, opening.stamp_ns, PANEL_FRAME),
        reference_stamp=stamp_message(make, opening.reference_stamp_ns),
        method=make("rgbd_dic_msgs/msg/Method", value=METHOD_CODES[opening.method]),
        valid=opening.valid,
        status=_status(make, opening.status),
        reason=opening.reason,
        opening=opening.opening_m,
        sliding=opening.sliding_m,
        out_of_plane=opening.out_of_plane_m,
        magnitude=opening.magnitude_m,
        u_opening=opening.u_opening_m,
        u_sliding=opening.u_sliding_m,
        u_out_of_plane=opening.u_out_of_plane_m,
        u_magnitude=opening.u_magnitude_m,
        n_left=opening.n_left,
        n_right=opening.n_right,
        depth_offset=opening.depth_offset_s,
        latency=opening.latency_s,
    )


def crack_opening_from_message(msg: Any) -> CrackOpening:
    return CrackOpening(
        stamp_to_ns(msg.header.stamp),
        stamp_to_ns(msg.reference_stamp),
        METHOD_NAMES[msg.method.value],
        FrameStatus(msg.status.value),
        msg.reason,
        msg.opening,
        msg.sliding,
        msg.out_of_plane,
        msg.magnitude,
        msg.u_opening,
        msg.u_sliding,
        msg.u_out_of_plane,
        msg.u_magnitude,
        int(msg.n_left),
        int(msg.n_right),
        msg.depth_offset,
        msg.latency,
    )


def write_opening_history(response: Any, openings: Openings) -> Any:
    """The response of rgbd_dic_msgs/srv/OpeningHistory, filled."""
    response.stamps = array("q", openings.stamps_ns.tobytes())
    response.opening = array("f", openings.opening_m.tobytes())
    response.u_opening = array("f", openings.u_m.tobytes())
    return response


def openings_from_history(response: Any) -> Openings:
    return Openings(
        np.array(response.stamps, np.int64),
        np.array(response.opening, np.float32),
        np.array(response.u_opening, np.float32),
    )


def _status(make: MessageFactory, status: FrameStatus) -> Any:
    return make("rgbd_dic_msgs/msg/FrameStatus", value=int(status))


def _array(values: Any, dtype: str = "f8") -> NDArray:
    return np.frombuffer(values, dtype) if len(values) else np.zeros(0, dtype)
