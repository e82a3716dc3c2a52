"""Boards found in shots, less those that cannot be used, each with its reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import CalibrationError, ImageError

from .board import Board
from .detection import Found, column_direction, find_board, turned
from .model import View
from .settings import CalibratingSettings
from .sources import Shot, moved_px

SENSORS = ("camera", "tof")
WORDS = {"camera": "camera", "tof": "ToF sensor"}


@dataclass(frozen=True)
class BoardView(View):
    """A pose of the board with the images in which it was found, and the ToF sensor's depth [m], if there is any."""

    images: dict[str, NDArray[Any]] | None = None
    depth_m: NDArray[np.float32] | None = None

    def without(self, sensor: str) -> BoardView:
        return replace(self, **{sensor: None}, depth_m=None if sensor == "tof" else self.depth_m)


@dataclass(frozen=True)
class Skipped:
    """An image that is not used."""

    name: str
    sensor: str
    reason: str


class Gathering:
    """The boards of all shots. What is dropped goes to `skipped`.

    Attributes:
        views: with a board in at least one image.
        skipped: images without use, in the order in which they were dropped.
        sizes: sensor -> (width, height) of its images; only of sensors with images.
        seen: sensor -> number of its images.
    """

    def __init__(self, shots: Iterable[Shot], board: Board, advance: Callable[[], None] | None = None) -> None:
        self.board = board
        self.views: list[BoardView] = []
        self.skipped: list[Skipped] = []
        self.seen: Counter[str] = Counter()
        sizes: dict[str, Counter[tuple[int, int]]] = {sensor: Counter() for sensor in SENSORS}
        self._moved_px: dict[str, float] = {}
        for shot in shots:
            self._add(shot, sizes)
            if advance is not None:
                advance()
        self.sizes = {sensor: count.most_common(1)[0][0] for sensor, count in sizes.items() if count}
        self._check_sensors()
        for sensor, (width, height) in self.sizes.items():
            self._drop(
                sensor,
                lambda view, s=sensor, size=(width, height): (
                    f"it has {_size(view.images[s])} pixels, other images {size[0]} x {size[1]}"
                    if view.images[s].shape[::-1] != size
                    else ""
                ),
            )

    def screen(self, settings: CalibratingSettings) -> None:
        """Drop boards that are blurred, moved between the exposures or are like another one; thin out the rest."""
        for sensor in SENSORS:
            rises = [view.of(sensor).rise_px for view in self.views if view.of(sensor)]
            usual = float(np.median(rises)) if rises else 0.0
            self._drop(sensor, lambda view, s=sensor, u=usual: _blur(view.of(s), u, settings.blurred))
        self._drop(
            "tof",
            lambda view: (
                f"the board moved by {self._moved_px[view.name]:.1f} px (at most {settings.moving_px:g}) between this "
                "frame and the camera's image: hold it still"
                if view.camera and self._moved_px[view.name] > settings.moving_px
                else ""
            ),
        )
        kept: list[BoardView] = []
        for view in self.views:
            twin = next((other for other in kept if self._difference(view, other) < settings.alike), None)
            if twin is None:
                kept.append(view)
            else:
                self._skip(view, f"the board is where it was in {twin.name}")
        self.views = self._most_different(kept, settings.most_views)

    def drop(self, view: int, sensor: str, reason: str) -> None:
        """Leave one image out."""
        dropped = self.views[view]
        self.skipped.append(Skipped(dropped.name, sensor, reason))
        self.views[view] = dropped.without(sensor)
        self.views = [view for view in self.views if view.camera or view.tof]

    def count(self, *sensors: str) -> int:
        """Views in which all of these sensors see the board."""
        return sum(all(view.of(sensor) for sensor in sensors) for view in self.views)

    def _add(self, shot: Shot, sizes: dict[str, Counter[tuple[int, int]]]) -> None:
        found: dict[str, Found] = {}
        images = {sensor: getattr(shot, sensor) for sensor in SENSORS if getattr(shot, sensor) is not None}
        for sensor, image in images.items():
            sizes[sensor][image.shape[::-1]] += 1
            self.seen[sensor] += 1
            try:
                found[sensor] = find_board(image, self.board)
            except ImageError as error:
                self.skipped.append(Skipped(shot.name, sensor, str(error)))
        if shot.depth_m is not None and shot.tof is not None and shot.depth_m.shape != shot.tof.shape:
            raise ImageError(
                f"{shot.name}: depth has {_size(shot.depth_m)} pixels, the ToF intensity image {_size(shot.tof)}: they "
                "must be of one sensor. Were camera images given as ToF images?"
            )
        if len(found) == 2 and self.board.looks_turned:
            along = [column_direction(found[sensor], self.board) for sensor in SENSORS]
            if along[0] @ along[1] < 0:
                found["tof"] = turned(found["tof"], self.board)
        if found:
            view = BoardView(shot.name, found.get("camera"), found.get("tof"), images, shot.depth_m)
            self._moved_px[shot.name] = moved_px(shot, view.camera.corners_px) if len(found) == 2 else 0.0
            self.views.append(view)

    def _check_sensors(self) -> None:
        if set(self.sizes) != set(SENSORS):
            return
        camera, tof = (self.sizes[sensor] for sensor in SENSORS)
        if camera[0] * camera[1] < tof[0] * tof[1]:
            raise CalibrationError(
                f"camera images have {camera[0]} x {camera[1]} pixels and ToF images {tof[0]} x {tof[1]}, but the ToF "
                "sensor has fewer pixels than the camera: the two are swapped"
            )

    def _drop(self, sensor: str, why: Callable[[BoardView], str]) -> None:
        for place in reversed(range(len(self.views))):
            if self.views[place].of(sensor) and (reason := why(self.views[place])):
                self.drop(place, sensor, reason)

    def _skip(self, view: BoardView, reason: str) -> None:
        self.skipped += [Skipped(view.name, sensor, reason) for sensor in SENSORS if view.of(sensor)]

    def _difference(self, view: BoardView, other: BoardView) -> float:
        """How far corners are apart in two views, RMS over the image's width; the larger of both sensors'."""
        differences = [np.inf] if any(bool(view.of(s)) != bool(other.of(s)) for s in SENSORS) else []
        for sensor in SENSORS:
            a, b = view.of(sensor), other.of(sensor)
            if a and b:
                _, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
                apart = np.sum((a.corners_px[i] - b.corners_px[j]) ** 2, axis=1)
                width = self.sizes[sensor][0]
                differences.append(float(np.sqrt(apart.mean())) / width if len(i) else np.inf)
        return max(differences)

    def _most_different(self, views: list[BoardView], most: int) -> list[BoardView]:
        """The first view, and then always the one that differs most from all before; in their old order."""
        if len(views) <= most:
            return views
        chosen = [0]
        nearest = np.array([min(self._difference(view, views[0]), 10.0) for view in views])
        while len(chosen) < most:
            chosen.append(int(np.argmax(nearest)))
            again = [min(self._difference(view, views[chosen[-1]]), 10.0) for view in views]
            nearest = np.minimum(nearest, again)
        for place in sorted(set(range(len(views))) - set(chosen)):
            self._skip(views[place], f"there are {len(views)} boards; the {most} most different ones are used")
        return [views[place] for place in sorted(chosen)]


def _blur(found: Found, usual_px: float, times: float) -> str:
    limit = min(times * usual_px, found.spacing_px)
    if found.rise_px <= limit:
        return ""
    return f"blurred: its edges are {found.rise_px:.1f} px wide, others {usual_px:.1f} px"


def _size(image: NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
