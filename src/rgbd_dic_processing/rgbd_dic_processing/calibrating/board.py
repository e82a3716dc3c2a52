"""The calibration board: a checkerboard or a ChArUco board."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import SettingsError
from rgbd_dic_acquisition.settings import Settings, setting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BoardSettings(Settings):
    """What is printed on the board. Rows and columns count squares, not inner corners (thesis 4.2.2)."""

    kind: str = setting("checkerboard", choices=("checkerboard", "charuco"), doc="pattern of the board")
    rows: int = setting(9, unit="squares", low=3, high=100, doc="squares from top to bottom")
    cols: int = setting(12, unit="squares", low=3, high=100, doc="squares from left to right")
    square_m: float = setting(0.030, unit="m", low=0.001, high=1.0, doc="side of a square")
    marker_m: float = setting(0.0225, unit="m", low=0.0005, high=1.0, doc="ChArUco: side of a marker, with its border")
    dictionary: str = setting("DICT_4X4_250", doc="ChArUco: dictionary of its markers, as OpenCV names it")
    legacy: bool = setting(False, doc="ChArUco: even rows as OpenCV before 4.6 laid them")


class Board:
    """A board's inner corners, in its own frame: x right, y down, z away from the viewer, origin at its middle."""

    def __init__(self, settings: BoardSettings) -> None:
        self.settings = s = settings
        if s.kind == "checkerboard" and s.rows == s.cols:
            raise SettingsError(
                f"a checkerboard of {s.rows} x {s.cols} squares looks the same when it is turned by 90 degrees: "
                "use one with unequal sides, or a ChArUco board"
            )
        if s.kind == "charuco" and s.marker_m >= s.square_m:
            raise SettingsError(
                f"marker of {s.marker_m * 1e3:g} mm in a square of {s.square_m * 1e3:g} mm: it must be smaller"
            )
        if s.kind == "charuco" and not isinstance(getattr(cv2.aruco, s.dictionary, None), int):
            raise SettingsError(f"OpenCV knows no dictionary {s.dictionary!r}; DICT_4X4_250 is one")
        col, row = np.meshgrid(np.arange(1, s.cols), np.arange(1, s.rows))
        corners = np.stack([col - s.cols / 2, row - s.rows / 2, np.zeros(col.shape)], axis=-1)
        self.corners_m: Array = s.square_m * corners.reshape(-1, 3)  # row by row

    @property
    def shape(self) -> tuple[int, int]:
        """Inner corners from top to bottom, and from left to right."""
        return self.settings.rows - 1, self.settings.cols - 1

    @property
    def looks_turned(self) -> bool:
        """Whether it looks the same when it is turned by 180 degrees."""
        return self.settings.kind == "checkerboard" and (self.settings.rows + self.settings.cols) % 2 == 0

    @property
    def clear_part(self) -> float:
        """How far from a corner there is nothing but its own edges, with some room for slant; part of a square."""
        s = self.settings
        return 0.33 if s.kind == "checkerboard" else min(0.33, 0.5 * (1 - s.marker_m / s.square_m))

    @property
    def words(self) -> str:
        s = self.settings
        name = "checkerboard" if s.kind == "checkerboard" else f"ChArUco board ({s.dictionary})"
        rows, cols = self.shape
        return f"{name} of {s.rows} x {s.cols} squares of {s.square_m * 1e3:g} mm ({rows} x {cols} inner corners)"

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoDetector:
        s = self.settings
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, s.dictionary))
        board = cv2.aruco.CharucoBoard((s.cols, s.rows), s.square_m, s.marker_m, dictionary)
        board.setLegacyPattern(s.legacy)
        return cv2.aruco.CharucoDetector(board)
