"""The corners of a board in one image, to a few hundredths of a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import ImageError

from .board import Board

Array = NDArray[np.float64]

LARGE_PX, SMALL_PX = 1000, 800  # width of images that are searched at half, and also at double their size
LONGEST_STEP = 0.25  # of the refinement, part of that distance; a corner that goes farther is left out
WIDEST_WINDOW_PX = 11
MIN_CHARUCO_CORNERS = 12


@dataclass(frozen=True)
class Found:
    """A board in an image.

    Attributes:
        corners_px: (N, 2) raw pixels.
        ids: (N,) which of `Board.corners_m` each is.
        rise_px: width of the edge between dark and light, across the more blurred of its two directions.
        spacing_px: median distance of a corner to the next one.
    """

    corners_px: Array
    ids: NDArray[np.int64]
    rise_px: float
    spacing_px: float


def find_board(image: NDArray[np.uint8] | NDArray[np.uint16], board: Board) -> Found:
    """The board in an image (rows, cols).

    Coarsely by OpenCV's sector-based detector (Duda and Frese 2018) or its markers, then each corner by
    `cornerSubPix`, which in rendered images is three times as exact as the detector.

    Raises:
        ImageError: there is no such board, or not all of it; with what is there instead.
    """
    grey8 = _in_8_bits(image)
    corners, ids = (_checkerboard if board.settings.kind == "checkerboard" else _charuco)(grey8, board)
    spacing = _spacings(corners, ids, board)
    refined = _refined(image, corners, board.clear_part * float(spacing.min()))
    kept = np.linalg.norm(refined - corners, axis=1) < LONGEST_STEP * spacing
    if kept.sum() < max(MIN_CHARUCO_CORNERS, 0.9 * len(corners)):
        raise ImageError(f"blurred or too dark: only {kept.sum()} of {len(corners)} corners can be located")
    found = Found(refined[kept], ids[kept], 0.0, float(np.median(spacing)))
    return replace(found, rise_px=_edge_rise(image, found, board))


def turned(found: Found, board: Board) -> Found:
    """The same corners, taken as those of the board turned by 180 degrees."""
    return replace(found, ids=len(board.corners_m) - 1 - found.ids)


def column_direction(found: Found, board: Board) -> Array:
    """Mean direction (2,), in pixels, in which the board's x axis points in the image."""
    return _directions(found, board)[0]


def _in_8_bits(image: NDArray) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return image
    dark, light = np.percentile(image, [1, 99])
    return np.clip((image - dark) * (255.0 / max(light - dark, 1.0)), 0, 255).astype(np.uint8)


def _scaled(image: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    if scale == 1:
        return image
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)


def _scales(image: NDArray[np.uint8]) -> tuple[float, ...]:
    width = image.shape[1]
    return (0.5, 1.0) if width > LARGE_PX else (1.0, 2.0) if width < SMALL_PX else (1.0,)


def _checkerboard(image: NDArray[np.uint8], board: Board) -> tuple[Array, NDArray[np.int64]]:
    rows, cols = board.shape
    for scale in _scales(image):
        # "larger" so that a part of a larger board is not taken for the one that was asked for
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER | (cv2.CALIB_CB_EXHAUSTIVE if scale > 0.5 else 0)
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(_scaled(image, scale), (cols, rows), flags)
        if found and meta.shape != (rows, cols):
            raise ImageError(_another(board, meta.shape))
        if found:
            grid = (corners.reshape(rows, cols, 2).astype(float) + 0.5) / scale - 0.5
            return _oriented(image, grid, board).reshape(-1, 2), np.arange(rows * cols)
    raise ImageError(_what_is_there(image, board))


def _oriented(image: NDArray[np.uint8], grid: Array, board: Board) -> Array:
    """The grid (rows, cols, 2), not mirrored, and beginning beside the dark corner square if there is but one."""
    across, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    if np.linalg.det([across.mean(axis=0), down.mean(axis=0)]) < 0:
        grid = grid[::-1]
    if not board.looks_turned:
        middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
        col, row = np.clip(np.rint(middles), 0, np.array(image.shape)[::-1] - 1).astype(int).reshape(-1, 2).T
        grey = image[row, col].astype(float)
        even = np.indices(middles.shape[:2]).sum(axis=0).ravel() % 2 == 0
        if grey[even].mean() > grey[~even].mean():
            grid = grid[::-1, ::-1]
    return grid


def _what_is_there(image: NDArray[np.uint8], board: Board) -> str:
    """In words, why a checkerboard was not found."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
    if not found or meta.size < 12:
        return f"no {board.words}: nothing like a checkerboard was seen"
    margin = np.median(np.linalg.norm(np.diff(corners.reshape(*meta.shape, 2), axis=1), axis=-1))  # a square
    at_edge = np.any((corners < margin) | (corners > np.array(image.shape)[::-1] - 1 - margin))
    return _another(board, meta.shape, "it is cut off by the edge of the image" if at_edge else "it is partly covered")


def _another(board: Board, seen: tuple[int, ...], cause: str = "") -> str:
    """In words, that a checkerboard has another number of inner corners than it should."""
    rows, cols = sorted(seen)
    words = f"{rows} x {cols} inner corners ({rows + 1} x {cols + 1} squares)"
    wanted = sorted(board.shape)
    if [rows + 1, cols + 1] == wanted or [rows - 1, cols - 1] == wanted:
        return f"no {board.words}, but one of {words}: are these the squares or the inner corners? Give squares"
    if rows <= wanted[0] and cols <= wanted[1]:
        return f"no {board.words}, only {words}: {cause or 'it is partly covered'}, or it is another board"
    return f"no {board.words}, but one of {words}: give the size of the board that was used"


def _charuco(image: NDArray[np.uint8], board: Board) -> tuple[Array, NDArray[np.int64]]:
    most = 0
    for scale in _scales(image)[::-1]:
        corners, ids, _, _ = board.charuco.detectBoard(_scaled(image, scale))
        if ids is None:
            continue
        ids = ids.ravel().astype(np.int64)
        row, col = np.divmod(ids, board.shape[1])
        if len(ids) >= MIN_CHARUCO_CORNERS and len(set(row)) > 2 and len(set(col)) > 2:
            return (corners.reshape(-1, 2).astype(float) + 0.5) / scale - 0.5, ids
        most = max(most, len(ids))
    raise ImageError(
        f"no {board.words}: {most} of its corners were seen, at least {MIN_CHARUCO_CORNERS} in three rows and columns "
        "are needed; it may be another board or dictionary, cut off, blurred, or too far away to read its markers"
    )


def _refined(image: NDArray, corners: Array, clear_px: float) -> Array:
    """By the gradients in a window that reaches at most so far, and so to nothing but the corner's own edges."""
    half = int(np.clip(clear_px, 2, WIDEST_WINDOW_PX))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    start = corners.reshape(-1, 1, 2).astype(np.float32)
    return (
        cv2.cornerSubPix(image.astype(np.float32), start, (half, half), (-1, -1), criteria).reshape(-1, 2).astype(float)
    )


def _neighbours(ids: NDArray[np.int64], board: Board) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Pairs of places in `ids`, each a corner and the next one: along the rows, and along the columns."""
    place = np.full(len(board.corners_m), -1)
    place[ids] = np.arange(len(ids))
    grid = place.reshape(board.shape)
    pairs = ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:]))
    return tuple(tuple(side[(a >= 0) & (b >= 0)] for side in (a, b)) for a, b in pairs)


def _spacings(corners: Array, ids: NDArray[np.int64], board: Board) -> Array:
    """(N,) distance of each corner to the nearest one beside it [px]."""
    nearest = np.full(len(ids), np.inf)
    for a, b in _neighbours(ids, board):
        length = np.linalg.norm(corners[a] - corners[b], axis=1)
        np.minimum.at(nearest, a, length)
        np.minimum.at(nearest, b, length)
    alone = np.isinf(nearest)
    return np.where(alone, np.median(nearest[~alone]), nearest)


def _directions(found: Found, board: Board) -> Array:
    """Mean unit directions (2, 2) of the board's x and y axes in the image."""
    means = [np.mean(found.corners_px[b] - found.corners_px[a], axis=0) for a, b in _neighbours(found.ids, board)]
    return np.array(means) / np.linalg.norm(means, axis=1, keepdims=True)


def _edge_rise(image: NDArray, found: Found, board: Board) -> float:
    """How many pixels the step from dark to light takes: contrast over the steepest slope, in the worse direction."""
    half = int(np.clip(found.spacing_px / 2, 2, 30))
    grey = image.astype(np.float32)
    slopes = np.stack(
        [cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 8)], -1
    )
    along = _directions(found, board)
    across = np.stack([along[1] @ [[0, -1], [1, 0]], along[0] @ [[0, -1], [1, 0]]])
    rises = []
    for x, y in np.rint(found.corners_px).astype(int):
        window = np.s_[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
        low, high = np.percentile(grey[window], [5, 95])
        steepest = np.percentile(np.abs(slopes[window] @ across.T.astype(np.float32)), 97, axis=(0, 1))
        rises.append((high - low) / np.maximum(steepest, 1e-6))
    return float(np.median(rises, axis=0).max())
