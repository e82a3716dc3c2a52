"""The file `regions.yaml` (docs/files.md)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RegionsError

from .regions import CrackZones, Regions

Array = NDArray[np.float64]
ENTRIES = ("panel", "fixed", "fixed_holes", "x_axis", "crack")


def read_entries(path: Path | str) -> dict[str, Any]:
    """The entries of regions.yaml as they stand there, which may be without a panel.

    Raises:
        RegionsError: if the file cannot be read, or has an entry that is not known.
    """
    try:
        content = yaml.safe_load(Path(path).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RegionsError(f"cannot read regions {path}: {error}") from error
    return known_entries(content, str(path))


def known_entries(content: Any, where: str) -> dict[str, Any]:
    """The content of a regions.yaml, if it is a mapping of entries that are known.

    Raises:
        RegionsError: naming where it is from, and what is not known.
    """
    if not isinstance(content, dict):
        raise RegionsError(f"{where}: needs an entry 'panel' (see docs/files.md)")
    unknown = sorted(str(entry) for entry in set(content) - set(ENTRIES))
    if unknown:
        raise RegionsError(f"{where}: unknown entry {', '.join(unknown)}; known are {', '.join(ENTRIES)}")
    return content


def load_regions(path: Path | str) -> Regions:
    """Read regions.yaml.

    Raises:
        RegionsError: naming the file, the entry and what is wrong with it.
    """
    content = read_entries(path)
    try:
        return regions_of(content)
    except RegionsError as error:
        raise RegionsError(f"{path}: {error}") from error


def regions_of(entries: Mapping[str, Any]) -> Regions:
    """The regions that the entries of regions.yaml describe.

    Raises:
        RegionsError: naming the entry and what is wrong with it.
    """
    if "panel" not in entries:
        raise RegionsError("needs an entry 'panel' (see docs/files.md)")
    return Regions(
        panel=_points(entries["panel"], "panel", least=3),
        fixed=_polygons(entries, "fixed"),
        x_axis=_axis(entries.get("x_axis")),
        crack=_crack(entries.get("crack")),
        fixed_holes=_polygons(entries, "fixed_holes"),
        entries=entries,
    )


def entries_of_text(text: str) -> dict[str, Any]:
    """The entries of a regions.yaml, from its text.

    Raises:
        RegionsError: if it is none, or uses YAML that no regions need.
    """
    try:
        if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):
            raise RegionsError("the file has YAML aliases (*name): write the numbers out")
        content = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise RegionsError(f"this is not a regions.yaml: {str(error)[:200] or 'nested too deep'}") from error
    entries = known_entries(content, "this file")
    regions_of({"panel": [[0, 0], [1, 0], [1, 1]], **entries})  # one without a panel is welcome
    return entries


def text_of(entries: Mapping[str, Any]) -> str:
    """These entries as YAML."""
    return yaml.dump(dict(entries), Dumper=_Plain, sort_keys=False, default_flow_style=None)


def write_entries(entries: Mapping[str, Any], path: Path, heading: str) -> None:
    """Write regions.yaml, whole or not at all, with a line of comment above the entries.

    Raises:
        RegionsError: if it cannot be written.
    """
    beside = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(f"# {heading}\n{text_of(entries)}")
        beside.replace(path)
    except OSError as error:
        raise RegionsError(f"cannot write {path}: {error.strerror}") from error


class _Plain(yaml.SafeDumper):
    """Writes out what is there twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _polygons(entries: Mapping[str, Any], name: str) -> tuple[Array, ...]:
    polygons = entries.get(name) or []
    if not isinstance(polygons, list):
        raise RegionsError(f"{name}: expected a list of polygons, got {polygons!r}")
    return tuple(_points(polygon, f"{name}[{i}]", least=3) for i, polygon in enumerate(polygons))


def _points(value: Any, name: str, least: int) -> Array:
    try:
        points = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise RegionsError(f"{name}: expected a list of points [x, y], got {value!r}") from error
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < least or not np.all(np.isfinite(points)):
        raise RegionsError(f"{name}: expected at least {least} points [x, y] in pixels, got {value!r}")
    return points


def _axis(value: Any) -> Array | None:
    if value is None:
        return None
    points = _points(value, "x_axis", least=2)
    if len(points) != 2 or np.array_equal(points[0], points[1]):
        raise RegionsError(f"x_axis: expected two different points, got {value!r}")
    return points


def _crack(value: Any) -> CrackZones | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        raise RegionsError(f"crack: expected left and right, or point, direction and size; got {value!r}")
    direction = _numbers(value["direction"], "crack: direction", 2) if "direction" in value else None
    if direction is not None and not np.any(direction):
        raise RegionsError("crack: direction must not be [0, 0]")
    if {"left", "right"} <= set(value):
        boxes = [_numbers(value[side], f"crack: {side}", 4) for side in ("left", "right")]
        return CrackZones.from_rectangles(boxes[0], boxes[1], direction)
    if {"point", "direction", "size"} <= set(value):
        across, along = _numbers(value["size"], "crack: size", 2)
        gap = float(_numbers([value.get("gap", 0)], "crack: gap", 1)[0])
        if across <= 0 or along <= 0 or gap < 0:
            raise RegionsError(f"crack: size {across:g} x {along:g} px must be above 0, gap {gap:g} px not below 0")
        return CrackZones.from_point(_numbers(value["point"], "crack: point", 2), direction, across, along, gap)
    raise RegionsError("crack: give either left and right, or point, direction and size (see docs/files.md)")


def _numbers(value: Any, name: str, count: int) -> Array:
    try:
        numbers = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise RegionsError(f"{name}: expected {count} numbers, got {value!r}") from error
    if numbers.shape != (count,) or not np.all(np.isfinite(numbers)):
        raise RegionsError(f"{name}: expected {count} numbers, got {value!r}")
    return numbers
