"""Images of boards, from folders or from a bag, one pose of the board after the other."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.errors import BagError, ImageError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import CAMERA_INFO, IMAGE, depth_from_message, image_from_message
from rgbd_dic_acquisition.recording_files import DEPTH_SUFFIXES, IMAGE_SUFFIXES, find_files, read_depth, read_image

SAME_FRAME_NS = 5_000_000  # a ToF sensor's depth and intensity belong together if their stamps differ by less
PAIR_NS = 50_000_000  # and a camera image goes with it if it is nearer than this
CAMERA_TOPIC, TOF_TOPIC, DEPTH_TOPIC = "camera/image_raw", "tof/intensity/image_raw", "tof/depth/image_raw"
INFO_OF = {CAMERA_TOPIC: "camera/camera_info", TOF_TOPIC: "tof/depth/camera_info"}


@dataclass(frozen=True)
class Shot:
    """What the sensors saw of one pose of the board; None where there is no image.

    Attributes:
        camera, tof: (rows, cols), 8 or 16 bits.
        depth_m: (rows, cols) of the ToF sensor, NaN for none.
        neighbour: another camera image, `neighbour_offset` times as far in time from `camera` as the ToF frame is; to
            see whether the board moves. None if nothing can have moved.
    """

    name: str
    camera: NDArray[Any] | None = None
    tof: NDArray[Any] | None = None
    depth_m: NDArray[np.float32] | None = None
    neighbour: NDArray[Any] | None = None
    neighbour_offset: float = 1.0


class Source(Protocol):
    """Gives shots; `len` of it is how many there will be."""

    notes: list[str]

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Shot]: ...


class Folders:
    """Images in folders, one for each sensor; those with the same name, or else in the same place, belong together."""

    def __init__(self, camera: Path, tof: Path | None = None, depth: Path | None = None) -> None:
        self.notes: list[str] = []
        if depth is not None and tof is None:
            raise ImageError("depth files without ToF intensity images: give the folder of these too")
        camera_files = find_files(camera, IMAGE_SUFFIXES, "camera image")
        tof_files = find_files(tof, IMAGE_SUFFIXES, "ToF intensity image") if tof else []
        depth_files = find_files(depth, DEPTH_SUFFIXES, "depth") if depth else []
        if any(file.suffix.lower() == ".ply" for file in depth_files):
            raise ImageError(f"{depth} has clouds: the depth bias needs depth images (.png or .npy)")
        names = self._names(tof_files, camera_files, "ToF images", "camera images")
        depth_names = self._names(depth_files, tof_files, "depth files", "ToF images")
        by_name: dict[str, dict[str, Path]] = {file.stem: {"camera": file} for file in camera_files}
        for file in tof_files:
            by_name.setdefault(names[file], {})["tof"] = file
        for file in depth_files:
            tof_file = next((f for f in tof_files if f.stem == depth_names[file]), None)
            if tof_file is not None:
                by_name[names[tof_file]]["depth"] = file
        self._files = by_name

    def _names(self, files: Sequence[Path], others: Sequence[Path], what: str, other: str) -> dict[Path, str]:
        """file -> name of what it belongs to."""
        if not files or {file.stem for file in files} & {file.stem for file in others}:
            return {file: file.stem for file in files}
        if len(files) != len(others):
            raise ImageError(
                f"{len(files)} {what}, {len(others)} {other}, and no two with the same name: give the same name to "
                "files that belong together"
            )
        self.notes.append(f"{what} and {other} have no names in common: they are taken in the order of their names")
        return {file: partner.stem for file, partner in zip(files, others, strict=True)}

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[Shot]:
        for name, files in self._files.items():
            yield Shot(
                name,
                read_image(files["camera"]) if "camera" in files else None,
                read_image(files["tof"]) if "tof" in files else None,
                read_depth(files["depth"]) if "depth" in files else None,
            )


class Bag:
    """A recording of boards: every so often a ToF frame, and the camera images before and after it.

    A bag without ToF intensity gives camera images alone.
    """

    def __init__(self, path: Path, every_s: float) -> None:
        self.notes: list[str] = []
        self._path = path
        with BagReader(path) as bag:
            names = {name: self._topic(bag, name) for name in (CAMERA_TOPIC, TOF_TOPIC, DEPTH_TOPIC)}
            if names[CAMERA_TOPIC] is None:
                bag.require(CAMERA_TOPIC, IMAGE)
            stamps: dict[str, list[int]] = {name: [] for name in names}
            key = {topic: name for name, topic in names.items() if topic}
            for topic, _, _, data in bag.raw_messages(list(key)):
                stamps[key[topic]].append(header_stamp_ns(data))
            self._check_sizes(bag, names)
        self._topics = names
        self._camera_ns, self._depth_ns = sorted(stamps[CAMERA_TOPIC]), sorted(stamps[DEPTH_TOPIC])
        if names[TOF_TOPIC] is None:
            self.notes.append(f"{path} has no {TOF_TOPIC}: the camera is calibrated alone")
        timing = sorted(stamps[TOF_TOPIC]) if names[TOF_TOPIC] else self._camera_ns
        self._chosen: list[int] = []
        for stamp in timing:
            if not self._chosen or stamp - self._chosen[-1] >= every_s * 1e9:
                self._chosen.append(stamp)

    @staticmethod
    def _topic(bag: BagReader, name: str) -> str | None:
        try:
            return bag.require(name, IMAGE)
        except BagError:
            return None

    def _check_sizes(self, bag: BagReader, names: dict[str, str | None]) -> None:
        """Images must be as large as their camera_info says.

        Raises:
            ImageError: they are not; the topics may be swapped.
        """
        for name, info in INFO_OF.items():
            try:
                topics = (bag.require(info, CAMERA_INFO), names[name])
            except BagError:
                continue
            if topics[1] is None:
                continue
            said, image = (next((m for _, _, m in bag.messages([topic])), None) for topic in topics)
            if said is None or image is None or not said.width:
                continue
            if (said.width, said.height) != (image.width, image.height):
                raise ImageError(
                    f"{bag.path}: images on {topics[1]} have {image.width} x {image.height} pixels, but {topics[0]} "
                    f"says {said.width} x {said.height}: are the sensors swapped?"
                )

    def __len__(self) -> int:
        return len(self._chosen)

    def __iter__(self) -> Iterator[Shot]:
        wanted = {stamp: self._plan(stamp) for stamp in self._chosen}
        waiting = sorted(((max(ns for _, ns in plan.values()), stamp) for stamp, plan in wanted.items()), reverse=True)
        uses = Counter(key for plan in wanted.values() for key in plan.values())
        seen: dict[tuple[str, int], NDArray[Any]] = {}
        key_of = {topic: name for name, topic in self._topics.items() if topic}
        with BagReader(self._path) as bag:
            for topic, kind, _, data in bag.raw_messages(list(key_of)):
                key = (key_of[topic], header_stamp_ns(data))
                if key in uses and key not in seen:
                    convert = depth_from_message if key[0] == DEPTH_TOPIC else image_from_message
                    seen[key] = convert(bag.deserialise(kind, data)).copy()
                while waiting and all(part in seen for part in wanted[waiting[-1][1]].values()):
                    stamp = waiting.pop()[1]
                    yield self._shot(stamp, wanted[stamp], seen)
                    for part in wanted[stamp].values():
                        uses[part] -= 1
                        if not uses[part]:
                            seen[part] = np.empty(0)  # done with; large arrays are not kept

    def _plan(self, stamp: int) -> dict[str, tuple[str, int]]:
        """Which messages make the shot of this ToF frame (or camera image)."""
        if self._topics[TOF_TOPIC] is None:
            return {"camera": (CAMERA_TOPIC, stamp)}
        plan = {"tof": (TOF_TOPIC, stamp)}
        at = bisect_left(self._camera_ns, stamp)
        around = sorted(self._camera_ns[max(at - 2, 0) : at + 2], key=lambda ns: abs(ns - stamp))[:2]
        if around and abs(around[0] - stamp) < PAIR_NS:
            plan |= {role: (CAMERA_TOPIC, ns) for role, ns in zip(("camera", "neighbour"), around, strict=False)}
        depth = min(self._depth_ns, key=lambda ns: abs(ns - stamp), default=None)
        if depth is not None and abs(depth - stamp) < SAME_FRAME_NS:
            plan["depth_m"] = (DEPTH_TOPIC, depth)
        return plan

    def _shot(self, stamp: int, plan: dict[str, tuple[str, int]], seen: dict) -> Shot:
        images = {role: seen[key] for role, key in plan.items()}
        offset = 1.0
        if "neighbour" in plan:
            at, other = plan["camera"][1], plan["neighbour"][1]
            offset = abs((other - at) / (stamp - at)) if stamp != at else np.inf
        return Shot(f"{stamp * 1e-9:.3f} s", neighbour_offset=offset, **images)


def moved_px(shot: Shot, corners_px: NDArray[np.float64]) -> float:
    """How far the board moved in the camera's image between the exposures of the two sensors [px].

    From corners (N, 2) of the camera's image, followed into its neighbour by Lucas and Kanade's method; 0 if there is
    none.
    """
    if shot.neighbour is None or shot.camera is None:
        return 0.0
    if shot.camera.dtype != np.uint8 or shot.neighbour.shape != shot.camera.shape:
        return 0.0
    start = corners_px.reshape(-1, 1, 2).astype(np.float32)
    end, found, _ = cv2.calcOpticalFlowPyrLK(shot.camera, shot.neighbour, start, None, winSize=(31, 31))
    if found.mean() < 0.5:
        return np.inf
    shift = np.linalg.norm((end - start)[found.ravel() == 1], axis=-1)
    return float(np.median(shift) / shot.neighbour_offset)
