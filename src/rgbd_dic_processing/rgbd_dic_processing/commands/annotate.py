"""rgbd-dic annotate: a new bag of a recorded graph, with what Foxglove and rviz show of it (docs/viewers.md)."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.bag import BagReader, BagWriter
from rgbd_dic_acquisition.errors import BagError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.message_types import make_message
from rgbd_dic_acquisition.messages import (
    IMAGE,
    POINT_CLOUD,
    depth_from_message,
    image_from_message,
    points_from_message,
)
from rgbd_dic_acquisition.offered_qos import latched_topics

from ..core.view import made_small
from ..nodes.messages import (
    crack_opening_from_message,
    displacement_field_from_message,
    plane_from_message,
    reference_from_message,
    subset_field_from_message,
)
from ..nodes.same_stamp import SameStamp
from ..nodes.view_messages import ViewerSettings, band_message
from ..nodes.viewer import Viewer
from ..recorded import CAMERA_TOPIC, DEPTH_TOPIC, POINTS_TOPIC, calibration_of, has_clouds
from ..view_topics import VIEW_TYPES
from .options import beside
from .progress import progress

PERIOD_NS = 100_000_000  # between two images that are shown
WIDTH_PX = 800  # of a picture at most
NEEDED = {
    "image": (CAMERA_TOPIC, IMAGE),
    "reference": ("reference", "rgbd_dic_msgs/msg/Reference"),
    "subsets": ("subset_field", "rgbd_dic_msgs/msg/SubsetField"),
    "plane": ("plane", "rgbd_dic_msgs/msg/PlaneStamped"),
    "field": ("displacement_field", "rgbd_dic_msgs/msg/DisplacementField"),
    "opening": ("crack_opening", "rgbd_dic_msgs/msg/CrackOpening"),
}


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("annotate", help="add what viewers show to a bag", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag that a graph was recorded into, such as results/NAME/bag")
    parser.add_argument(
        "--calibration", type=Path, help="calibration.yaml (default: the one in the bag's directory, or beside it)"
    )
    parser.add_argument("--out", type=Path, required=True, help="directory of the new bag")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    with BagReader(options.bag) as bag:
        if there := sorted({name.lstrip("/") for name in bag.topics} & set(VIEW_TYPES)):
            raise BagError(f"{options.bag} has {', '.join(there)} already: open it as it is")
        path = options.calibration or beside(options.bag, "calibration.yaml") or beside_run(options.bag)
        viewer = Viewer(make_message, calibration_of(bag, path), ViewerSettings())
        names = {bag.require(*topic): part for part, topic in NEEDED.items()}
        depth = (POINTS_TOPIC, POINT_CLOUD) if has_clouds(bag) else (DEPTH_TOPIC, IMAGE)
        names[bag.require(*depth)] = "depth"
        with BagWriter(options.out) as out:
            annotation = Annotation(bag, out, viewer)
            latched = latched_topics(options.bag)
            for name, topic in bag.topics.items():
                out.add_topic(name, topic.type, transient_local=name in latched)
            with progress(sum(topic.count for topic in bag.topics.values()), "message") as bar:
                for topic, kind, log_time_ns, data in bag.raw_messages():
                    out.write(topic, log_time_ns, data)
                    if topic in names:
                        annotation.take(names[topic], kind, log_time_ns, data)
                    bar.update()
    print(f"{annotation.shown} images annotated: {options.out}")
    return 0


def beside_run(bag: Path) -> Path | None:
    """calibration.yaml of the run that a bag belongs to."""
    path = bag.parent / "calibration.yaml"
    return path if path.exists() else None


class Annotation:
    """Writes, after each message that completes an image, what viewers show of it.

    Attributes:
        shown: how many images that were.
    """

    def __init__(self, bag: BagReader, out: BagWriter, viewer: Viewer):
        self._bag, self._out, self._viewer = bag, out, viewer
        self._due_ns = 0
        self._together = SameStamp("image", dict.fromkeys(("subsets", "field", "opening"), 8), late=256)
        self._depth: tuple[str, bytes] | None = None
        self.shown = 0
        for topic, kind in VIEW_TYPES.items():
            out.add_topic(f"/{topic}", kind)

    def take(self, part: str, kind: str, log_time_ns: int, data: bytes) -> None:
        """A message, by what it is to an image."""
        if part == "depth":
            self._depth = kind, data
        elif part == "reference":
            self._viewer.know_reference(reference_from_message(self._bag.deserialise(kind, data)))
        elif part == "plane":
            self._viewer.know_plane(plane_from_message(self._bag.deserialise(kind, data)))
        else:
            if part == "opening":
                message = self._bag.deserialise(kind, data)
                band = band_message(make_message, crack_opening_from_message(message), message.header.frame_id)
                self._out.write_message("/view/opening", log_time_ns, band)
            stamp_ns = header_stamp_ns(data)
            if part == "image":
                if stamp_ns < self._due_ns:
                    return
                self._due_ns = stamp_ns + PERIOD_NS
            parts = self._together.add(part, stamp_ns, (kind, data))
            if parts is not None:
                self._show(log_time_ns, {name: self._bag.deserialise(*raw) for name, raw in parts.items()})

    def _show(self, log_time_ns: int, parts: dict[str, Any]) -> None:
        image, subsets = image_from_message(parts["image"]), subset_field_from_message(parts["subsets"])
        frame_id = parts["image"].header.frame_id
        messages = self._viewer.messages(
            frame_id,
            made_small(image, WIDTH_PX),
            subsets.homography,
            displacement_field_from_message(parts["field"]),
            crack_opening_from_message(parts["opening"]),
        )
        for topic, content in messages.items():
            self._out.write_message(f"/{topic}", log_time_ns, content())
        if self._depth is not None:
            kind, data = self._depth
            message, stamp_ns = self._bag.deserialise(kind, data), header_stamp_ns(data)
            if kind == POINT_CLOUD:
                cloud = self._viewer.cloud(stamp_ns, frame_id, points_from_message(message))
            else:
                cloud = self._viewer.cloud_of_depth(stamp_ns, frame_id, depth_from_message(message))
            self._out.write_message("/view/cloud", log_time_ns, cloud)
        self.shown += 1
