"""Old recordings: a folder of images, with or without depth and stamps, becomes a bag like any flight."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import messages
from .bag import BagWriter, make_message
from .calibration import Calibration, save_calibration
from .errors import ImageError
from .recording_files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    find_files,
    grey_limits,
    read_cloud,
    read_depth,
    read_image,
    read_stamps,
    to_mono8,
)
from .recording_rig import recording_rig, with_clouds, with_constant_plane, with_depth_images

CAMERA_FRAME, TOF_FRAME = "camera_optical_frame", "tof_optical_frame"
SECOND_NS = 10**9

Progress = Callable[[int, int], None]
Outgoing = Iterator[tuple[str, Any]]


@dataclass(frozen=True)
class ImportSummary:
    """What was written: the bag's directory, messages on each topic, and in words all that was assumed."""

    path: Path
    counts: dict[str, int]
    notes: tuple[str, ...]


def import_recording(
    images: Path | str,
    out: Path | str,
    *,
    depth: Path | str | None = None,
    stamps: Path | str | None = None,
    depth_stamps: Path | str | None = None,
    distance_m: float | None = None,
    calibration: Calibration | None = None,
    focal_px: float | None = None,
    frame_rate_hz: float = 30.0,
    compression: str = "none",
    progress: Progress | None = None,
) -> ImportSummary:
    """Write the bag `out`, and in it calibration.yaml.

    Args:
        images: folder of PNG or TIFF files, 8 or 16 bits, in the natural order of their names. 16 bits are
            scaled to mono8 with one scale for all, from the 0.1th to the 99.9th percentile of all pixels.
        depth: folder of depth files: 16-bit .png or integer .npy (millimetres), float .npy (metres), or .ply
            clouds (metres; millimetres if the median z is above 65). Without own stamps, one an image.
        stamps, depth_stamps: CSV with the header image,stamp_s or depth,stamp_s, one row a file [s].
        distance_m: of a plane that stands for missing depth, squarely in front of the camera [m]; None takes
            the distance at which a pixel is a millimetre.
        calibration: of the camera and, with depth that is not aligned with the images, of the ToF sensor.
        focal_px: focal length where there is no calibration [px]; None takes the image's width.
        frame_rate_hz: images a second where there are no stamps [Hz].
        progress: called with (files read, files to read); images of 16 bits are read twice.

    Raises:
        ImageError: files are missing, unreadable, of unequal size or kind, or do not match their stamps.
        CalibrationError: the calibration is of other image sizes, or lacks the ToF sensor.
        BagError: `out` exists or cannot be written.
    """
    if depth is None and depth_stamps is not None:
        raise ImageError("depth stamps without depth files: give the folder of the depth files too")
    if depth is not None and distance_m is not None:
        raise ImageError("both depth files and a distance: a distance is for recordings without depth")
    notes: list[str] = []
    image_files = find_files(Path(images), IMAGE_SUFFIXES, "image")
    depth_files = [] if depth is None else find_files(Path(depth), DEPTH_SUFFIXES, "depth")
    image_ns, depth_ns = _stamps(image_files, depth_files, stamps, depth_stamps, frame_rate_hz, notes)
    first = read_image(image_files[0])
    passes = 2 if first.dtype == np.uint16 else 1
    tick = _ticker(progress, passes * len(image_files) + len(depth_files))
    limits = _common_scale(image_files, tick, notes) if passes == 2 else None
    rig = recording_rig(first.shape, calibration, focal_px, notes)
    distance = None
    if not depth_files:
        rig, distance = with_constant_plane(rig, distance_m, notes)
    elif depth_files[0].suffix.lower() == ".ply":
        rig = with_clouds(rig, notes)
    else:
        rig = with_depth_images(rig, read_depth(depth_files[0]).shape, notes)
    recording = _Recording(rig, first.shape, first.dtype, limits, distance, notes)

    frames = [(stamp, 1, file) for stamp, file in zip(image_ns, image_files, strict=True)]
    frames += [(stamp, 0, file) for stamp, file in zip(depth_ns, depth_files, strict=True)]
    bag = BagWriter(out, compression)
    with _nothing_left_of(bag.path), bag:
        for topic, typename in recording.topics(depth_files).items():
            bag.add_topic(topic, typename, transient_local=topic == "/tf_static")
        start_ns = min(stamp for stamp, _, _ in frames)
        static = messages.transform_message(make_message, start_ns, rig, CAMERA_FRAME, TOF_FRAME)
        bag.write_message("/tf_static", start_ns, static)
        for stamp_ns, is_image, file in sorted(frames):
            outgoing = recording.image(stamp_ns, file) if is_image else recording.depth(stamp_ns, file)
            for topic, message in outgoing:
                bag.write_message(topic, stamp_ns, message)
            tick()
    save_calibration(rig, bag.path / "calibration.yaml")
    return ImportSummary(bag.path, dict(bag.counts), tuple(notes))


@contextmanager
def _nothing_left_of(path: Path) -> Iterator[None]:
    """Remove the half of a bag that was written when something fails."""
    try:
        yield
    except BaseException:
        shutil.rmtree(path)
        raise


@dataclass(frozen=True)
class _Recording:
    """What all frames have in common; turns one file into its messages."""

    rig: Calibration
    image_shape: tuple[int, ...]
    image_type: np.dtype[Any]
    limits: tuple[int, int] | None
    plane_distance_m: float | None
    notes: list[str]

    def topics(self, depth_files: Sequence[Path]) -> dict[str, str]:
        clouds = bool(depth_files) and depth_files[0].suffix.lower() == ".ply"
        depth = ("/tof/points", messages.POINT_CLOUD) if clouds else ("/tof/depth/image_raw", messages.IMAGE)
        names = {"/camera/image_raw": messages.IMAGE, "/camera/camera_info": messages.CAMERA_INFO}
        names[depth[0]] = depth[1]
        if self.rig.tof is not None:
            names["/tof/depth/camera_info"] = messages.CAMERA_INFO
        return {**names, "/tf_static": messages.TF}

    def image(self, stamp_ns: int, file: Path) -> Outgoing:
        if self.plane_distance_m is not None and self.rig.tof is not None:
            shape = (self.rig.tof.height, self.rig.tof.width)
            yield from self._depth_image(stamp_ns, np.full(shape, self.plane_distance_m, np.float32))
        pixels = read_image(file)
        if pixels.shape != self.image_shape or pixels.dtype != self.image_type:
            raise ImageError(
                f"{file} has {_kind(pixels.shape, pixels.dtype)}, but the first image "
                f"{_kind(self.image_shape, self.image_type)}: all images must be alike; put the others "
                "into a folder of their own"
            )
        grey = pixels if self.limits is None else to_mono8(pixels, self.limits)
        yield "/camera/image_raw", messages.image_message(make_message, stamp_ns, CAMERA_FRAME, grey, "mono8")
        info = messages.camera_info_message(make_message, stamp_ns, CAMERA_FRAME, self.rig.camera)
        yield "/camera/camera_info", info

    def depth(self, stamp_ns: int, file: Path) -> Outgoing:
        if file.suffix.lower() != ".ply":
            depth = read_depth(file)
            if self.rig.tof is None or depth.shape != (self.rig.tof.height, self.rig.tof.width):
                raise ImageError(f"{file} has {depth.shape[1]} x {depth.shape[0]} pixels, unlike the first depth file")
            yield from self._depth_image(stamp_ns, depth)
            return
        points, unit = read_cloud(file)
        note = f"clouds are in {unit}"
        if any(other.startswith("clouds are in ") and other != note for other in self.notes):
            raise ImageError(f"{file} is in {unit}, unlike the clouds before it; convert them to metres")
        if note not in self.notes:
            self.notes.append(note)
        yield "/tof/points", messages.points_message(make_message, stamp_ns, TOF_FRAME, points)
        if self.rig.tof is not None:
            yield "/tof/depth/camera_info", self._tof_info(stamp_ns)

    def _depth_image(self, stamp_ns: int, depth_m: NDArray[np.float32]) -> Outgoing:
        image = messages.image_message(make_message, stamp_ns, TOF_FRAME, depth_m, "32FC1")
        yield "/tof/depth/image_raw", image
        yield "/tof/depth/camera_info", self._tof_info(stamp_ns)

    def _tof_info(self, stamp_ns: int) -> Any:
        return messages.camera_info_message(make_message, stamp_ns, TOF_FRAME, self.rig.tof)


def _stamps(
    image_files: Sequence[Path],
    depth_files: Sequence[Path],
    stamps: Path | str | None,
    depth_stamps: Path | str | None,
    frame_rate_hz: float,
    notes: list[str],
) -> tuple[list[int], list[int]]:
    """Stamps [ns] of images and of depth files."""
    if stamps is not None:
        image_ns = read_stamps(Path(stamps), image_files, "image")
    elif frame_rate_hz > 0 and np.isfinite(frame_rate_hz):
        image_ns = [SECOND_NS + round(k * SECOND_NS / frame_rate_hz) for k in range(len(image_files))]
        notes.append(f"no stamps: {frame_rate_hz:g} images a second, the first at 1 s")
    else:
        raise ImageError(f"frame rate {frame_rate_hz!r} Hz: must be above 0")
    if depth_stamps is not None:
        depth_ns = read_stamps(Path(depth_stamps), depth_files, "depth")
    elif len(depth_files) not in (0, len(image_files)):
        raise ImageError(
            f"{len(depth_files)} depth files for {len(image_files)} images: without own stamps there must be "
            "one for each image; give depth stamps (a CSV with the header depth,stamp_s)"
        )
    else:
        depth_ns = image_ns[: len(depth_files)]
        if depth_files:
            notes.append("no depth stamps: depth files belong to the images in the order of their names")
    if min([*image_ns, *depth_ns]) == 0:
        image_ns, depth_ns = ([value + SECOND_NS for value in stream] for stream in (image_ns, depth_ns))
        notes.append("stamps start at 0: all were moved by 1 s, because ROS takes 0 for 'not set'")
    return image_ns, depth_ns


def _common_scale(files: Sequence[Path], tick: Callable[[], None], notes: list[str]) -> tuple[int, int]:
    """Grey levels of 16 bits that become 0 and 255 in all images."""
    histogram = np.zeros(1 << 16, np.int64)
    for file in files:
        histogram += np.bincount(read_image(file).ravel(), minlength=len(histogram))
        tick()
    limits = grey_limits(histogram)
    notes.append(
        f"16 bits scaled to 8: grey level {limits[0]} became 0 and {limits[1]} became 255 in all images "
        "(0.1th and 99.9th percentile of all pixels)"
    )
    return limits


def _ticker(progress: Progress | None, total: int) -> Callable[[], None]:
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    return tick


def _kind(shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    return f"{shape[1]} x {shape[0]} pixels of {8 * dtype.itemsize} bits"
