"""The files of an old recording, images, depth, clouds and stamps, as arrays; all rules of units are here."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import ImageError

IMAGE_SUFFIXES = (".png", ".tif", ".tiff")
DEPTH_SUFFIXES = (".png", ".npy", ".ply")
LARGEST_DEPTH_M = 65.0  # a larger median is taken for millimetres (clouds) or refused (arrays)
DARKEST, BRIGHTEST = 0.001, 0.999  # parts of all pixels of all images below 0 and above 255 after scaling


def find_files(folder: Path, suffixes: Sequence[str], what: str) -> list[Path]:
    """Files of a folder in natural order (img2 before img10).

    Raises:
        ImageError: no such folder, or none of these files in it.
    """
    if not folder.is_dir():
        raise ImageError(f"{folder} is not a folder: give the folder with the {what} files")
    files = [path for path in folder.iterdir() if path.suffix.lower() in suffixes]
    if not files:
        raise ImageError(f"{folder} has no {what} files ({', '.join(suffixes)})")
    return sorted(files, key=_natural)


def read_image(path: Path) -> NDArray[Any]:
    """A greyscale image (rows, cols), uint8 or uint16; colour is turned into grey.

    Raises:
        ImageError: it cannot be read, or has pixels of another type.
    """
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ImageError(f"{path} cannot be read as an image: it is damaged or of another format; remove it")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"{path} has pixels of type {pixels.dtype}: convert it to 8 or 16 bits")
    if pixels.ndim == 2:
        return pixels
    colour = pixels[..., :3]
    if np.all(colour == colour[..., :1]):
        return np.ascontiguousarray(colour[..., 0])
    return cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_BGR2GRAY)


def grey_limits(histogram: NDArray[np.int64]) -> tuple[int, int]:
    """Grey levels of 16 bits that become 0 and 255, from the histogram (65536,) of all images."""
    part = np.cumsum(histogram) / histogram.sum()
    dark, bright = (int(np.searchsorted(part, limit)) for limit in (DARKEST, BRIGHTEST))
    return dark, max(bright, dark + 1)


def to_mono8(pixels: NDArray[Any], limits: tuple[int, int]) -> NDArray[np.uint8]:
    """16 bits -> 8 bits, linear between the limits."""
    scaled = (pixels.astype(np.float64) - limits[0]) * (255.0 / (limits[1] - limits[0]))
    return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)


def read_depth(path: Path) -> NDArray[np.float32]:
    """Depth (rows, cols) in metres, NaN for none. 16-bit PNG, integer .npy: millimetres; float .npy: metres.

    Raises:
        ImageError: it cannot be read, is of another type or shape, or has no pixel in range.
    """
    if path.suffix.lower() == ".npy":
        try:
            values = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise ImageError(f"{path} cannot be read as a NumPy array: {error}") from error
    else:
        values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if values is None or values.dtype != np.uint16:
            kind = "unreadable" if values is None else values.dtype
            raise ImageError(f"{path} is {kind}: a depth PNG must have one channel of 16 bits, millimetres")
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        raise ImageError(
            f"{path} has shape {values.shape} and type {values.dtype}: depth must be (rows, cols), numbers"
        )
    depth = values * 1e-3 if values.dtype.kind in "iu" else values.astype(float)
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.nan)
    if np.isnan(depth).all():
        raise ImageError(f"{path} has no valid depth (finite, above 0)")
    if np.nanmedian(depth) > LARGEST_DEPTH_M:
        raise ImageError(
            f"{path} has a median depth of {np.nanmedian(depth):g} m: a float .npy is in metres; save "
            "millimetres as integers"
        )
    return depth.astype(np.float32)


def read_cloud(path: Path) -> tuple[NDArray[np.float32], str]:
    """Points (N, 3) [m] of a .ply and the unit it was in: millimetres if the median z is above 65.

    Raises:
        ImageError: it cannot be read, or has no points x, y, z.
    """
    from plyfile import PlyData  # only here: other recordings need no such library

    try:
        vertices = PlyData.read(str(path))["vertex"]
        points = np.stack([np.asarray(vertices[axis], float) for axis in "xyz"], axis=-1)
    except Exception as error:  # the library lets errors of many kinds through
        raise ImageError(f"{path} cannot be read as a cloud of vertices x, y, z: {error}") from error
    points = points[np.all(np.isfinite(points), axis=1) & (points[:, 2] > 0)]
    if len(points) == 0:
        raise ImageError(f"{path} has no valid point (finite, z above 0)")
    in_millimetres = np.median(points[:, 2]) > LARGEST_DEPTH_M
    scale = 1e-3 if in_millimetres else 1.0
    return (points * scale).astype(np.float32), "millimetres" if in_millimetres else "metres"


def read_stamps(path: Path, files: Sequence[Path], column: str) -> list[int]:
    """Stamps [ns] of files from a CSV with the columns `column` (a file's name) and stamp_s (seconds).

    Raises:
        ImageError: the table cannot be read, a file has no row or a row no file, or stamps do not increase.
    """
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImageError(f"cannot read the stamps {path}: {error}") from error
    if not rows or not {column, "stamp_s"} <= set(rows[0]):
        raise ImageError(f"{path} must be a CSV with the header {column},stamp_s and a row for each file")
    by_name: dict[str, int] = {}
    for line, row in enumerate(rows, start=2):
        name = (row[column] or "").strip()
        try:
            by_name[name] = int(Decimal((row["stamp_s"] or "").strip()) * 10**9)
        except (InvalidOperation, ValueError, OverflowError) as error:
            raise ImageError(f"{path}, line {line}: stamp_s = {row['stamp_s']!r} is no number") from error
    names = [file.name if file.name in by_name else file.stem for file in files]
    missing = [file.name for file, name in zip(files, names, strict=True) if name not in by_name]
    if missing or len(rows) != len(files):
        reason = f"no row for {missing[0]}" if missing else "rows that belong to no file, or double ones"
        raise ImageError(f"{path} has {len(rows)} rows for {len(files)} files: {reason}")
    stamps = [by_name[name] for name in names]
    for before, after, file in zip(stamps, stamps[1:], files[1:], strict=False):
        if after <= before:
            raise ImageError(
                f"{path}: stamps must increase in the order of the file names; {file.name} at "
                f"{after * 1e-9:.9f} s comes after {before * 1e-9:.9f} s"
            )
    if stamps[0] < 0:
        raise ImageError(f"{path}: stamp {stamps[0] * 1e-9:.9f} s is before 0; give seconds from 0 or later")
    return stamps


def _natural(path: Path) -> tuple[Any, ...]:
    parts = re.split(r"(\d+)", path.name)
    return (*[int(part) if part.isdigit() else part.lower() for part in parts], path.name)
