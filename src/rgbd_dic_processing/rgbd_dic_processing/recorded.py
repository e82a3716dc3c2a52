"""Offline: a bag through the pipeline, with the code that the nodes run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration, Camera, load_calibration
from rgbd_dic_acquisition.errors import BagError, CalibrationError, ImageError
from rgbd_dic_acquisition.messages import depth_from_message, image_from_message, stamp_to_ns
from scipy.spatial.transform import Rotation

from .core.pipeline import Measurement, Pipeline

IMAGE, CAMERA_INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
CAMERA_TOPIC, DEPTH_TOPIC = "camera/image_raw", "tof/depth/image_raw"
INFO_TOPICS = {"camera/camera_info": CAMERA_INFO, "tof/depth/camera_info": CAMERA_INFO}


def check_topics(bag: BagReader) -> None:
    """Refuse a bag that the graph could not measure.

    Raises:
        BagError: naming the missing topic and those that are there.
    """
    for topic, kind in {CAMERA_TOPIC: IMAGE, DEPTH_TOPIC: IMAGE, **INFO_TOPICS}.items():
        bag.require(topic, kind)


def calibration_of(bag: BagReader, path: Path | None) -> Calibration:
    """calibration.yaml if a path is given; else the bag's camera_infos and /tf_static.

    Raises:
        CalibrationError: if the bag's cameras are uncalibrated or the extrinsics are missing.
    """
    if path is not None:
        return load_calibration(path)
    cameras, frames = [], []
    for topic, kind in INFO_TOPICS.items():
        name = bag.require(topic, kind)
        info = next((message for _, _, message in bag.messages([name])), None)
        if info is None:
            raise BagError(f"{bag.path}: topic {name} is empty: give a calibration.yaml with --calibration")
        cameras.append(Camera.from_camera_info(info))
        frames.append(info.header.frame_id)
    R, t = _extrinsics(bag, *frames)
    return Calibration(cameras[0], cameras[1], R, t)


def _extrinsics(bag: BagReader, camera_frame: str, tof_frame: str) -> tuple[NDArray, NDArray]:
    """R, t of X_camera = R X_tof + t [m] from the bag's /tf_static."""
    messages = bag.messages(["/tf_static"]) if "/tf_static" in bag.topics else ()
    for _, _, message in messages:
        for stamped in message.transforms:
            if (stamped.header.frame_id, stamped.child_frame_id) == (camera_frame, tof_frame):
                q, t = stamped.transform.rotation, stamped.transform.translation
                return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), np.array([t.x, t.y, t.z])
    raise CalibrationError(
        f"{bag.path} has no transform {camera_frame} -> {tof_frame} on /tf_static: give a calibration.yaml with "
        "--calibration"
    )


def measure_bag(bag: BagReader, pipeline: Pipeline) -> Iterator[list[Measurement]]:
    """Yields once per message of the two image topics what it settled, in the order of the bag; flushes at the end.

    A message that cannot be read becomes an invalid frame with its reason.
    """
    camera_topic, depth_topic = bag.require(CAMERA_TOPIC, IMAGE), bag.require(DEPTH_TOPIC, IMAGE)
    for topic, _, message in bag.messages([camera_topic, depth_topic]):
        convert, add = (
            (image_from_message, pipeline.add_image)
            if topic == camera_topic
            else (depth_from_message, pipeline.add_depth)
        )
        try:
            pixels, reason = convert(message), ""
        except ImageError as error:
            pixels, reason = None, str(error)
        yield add(stamp_to_ns(message.header.stamp), pixels, reason)
    yield pipeline.flush()


def frame_count(bag: BagReader) -> int:
    """Messages that `measure_bag` will go through."""
    if not bag.topics:
        raise BagError(f"{bag.path} holds no messages")
    return sum(bag.topics[bag.require(topic, IMAGE)].count for topic in (CAMERA_TOPIC, DEPTH_TOPIC))
