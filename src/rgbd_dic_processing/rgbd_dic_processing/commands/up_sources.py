"""Where the images of `rgbd-dic up` come from: a bag, the simulated sensors, or a real payload."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.payload import load_payload

from ..core.settings import ProcessingSettings
from ..graph import SENSOR_TOPICS, GraphFiles, NodeSpec, simulated_sensors
from ..live_sensors import live_calibration, live_sensors
from ..recorded import check_topics, has_clouds
from .options import beside, complete_regions, required_file


@dataclass(frozen=True)
class Source:
    """What a graph is started on.

    label: what run.yaml calls it. sensors: the nodes that give the images; none for a bag, which a player plays: its
    topics, and how many images. use_points: whether its ToF frames are point clouds.
    """

    label: str
    files: GraphFiles
    sensors: tuple[NodeSpec, ...] = ()
    topics: tuple[str, ...] = ()
    images: int | None = None
    use_points: bool = False
    truth: Path | None = None


def source_of(options: argparse.Namespace, settings: ProcessingSettings) -> Source:
    """The source that the command line names.

    Raises:
        RgbdDicError: if a file is missing or malformed.
    """
    if options.bag:
        return _bag(options, settings)
    return _live(options) if options.live else _simulated(options)


def _bag(options: argparse.Namespace, settings: ProcessingSettings) -> Source:
    calibration_path = required_file(options.calibration, options.bag, "calibration.yaml")
    calibration = load_calibration(calibration_path)
    regions_path = required_file(options.regions, options.bag, "regions.yaml")
    with BagReader(options.bag) as bag:
        regions_path = complete_regions(bag, calibration, regions_path, settings, options.out)
        check_topics(bag)
        use_points = has_clouds(bag)
        recorded = {name.lstrip("/"): topic.count for name, topic in bag.topics.items()}
    if "camera/image_raw" not in recorded:
        raise RgbdDicError(f"{options.bag}: its topics are in a namespace; the graph plays bags without one only")
    return Source(
        str(options.bag),
        GraphFiles(calibration_path, regions_path),
        topics=tuple(topic for topic in SENSOR_TOPICS if topic in recorded),
        images=recorded["camera/image_raw"],
        use_points=use_points,
        truth=options.truth or beside(options.bag, "truth.csv"),
    )


def _simulated(options: argparse.Namespace) -> Source:
    calibration_path = required_file(options.calibration, options.out, "calibration.yaml")
    load_calibration(calibration_path)
    files = GraphFiles(calibration_path, required_file(options.regions, options.out, "regions.yaml"))
    return Source("simulated sensors", files, tuple(simulated_sensors()), truth=options.truth)


def _live(options: argparse.Namespace) -> Source:
    payload = load_payload(options.payload)
    calibration_path = live_calibration(options.calibration, payload)
    if load_calibration(calibration_path).tof is None:
        raise RgbdDicError(f"{calibration_path} has no 'tof': planes need its intrinsics and T_camera_tof")
    if options.regions is None:
        raise RgbdDicError(
            "no regions.yaml: give it with --regions; it is drawn on an image taken from where the flight begins, or "
            "anew on the live page, --page (see docs/payload.md)"
        )
    files = GraphFiles(calibration_path, options.regions)
    sensors = tuple(live_sensors(payload, calibration_path))
    return Source(f"payload {options.payload}", files, sensors, truth=options.truth)
