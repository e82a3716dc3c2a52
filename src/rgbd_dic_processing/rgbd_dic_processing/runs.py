"""A run's folder, results/<name>/: what was measured, from what, with which settings and versions (docs/files.md)."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from rgbd_dic_acquisition.errors import RgbdDicError

from .core.crack import CrackOpening
from .core.displacement_field import DisplacementField
from .core.stamps import Stretches
from .core.status import FrameStatus
from .core.subset_field import Reference
from .frame_files import FrameRecords
from .results import CSV_NAME, read_openings, write_openings

MAPS_NAME, RUN_NAME, REFERENCE_NAME = "displacement_maps.npz", "run.yaml", "reference.png"
TRUTH_NAME = "truth.csv"


class MapSelection:
    """Keeps, for each method, the displacement fields worth a map: at the widest opening, the last valid one, and the
    valid ones nearest to chosen moments.

    Of all fields it keeps the stamps of the keyframes after the reference, `renewed_ns`, and how often the stamps of a
    method's images jump back.

    Args:
        instants_s: the chosen moments, since the first image.
    """

    def __init__(self, instants_s: Sequence[float] = ()) -> None:
        self._instants_s, self._start_ns = instants_s, 0
        self._nearest: dict[tuple[str, float], tuple[float, DisplacementField]] = {}
        self._widest: dict[str, tuple[float, DisplacementField]] = {}
        self._last: dict[str, DisplacementField] = {}
        self._stamps: dict[str, Stretches] = {}
        self.renewed_ns: set[int] = set()

    def add(self, displacement: DisplacementField, opening: CrackOpening | None) -> None:
        self._start_ns = self._start_ns or displacement.stamp_ns
        self._stamps.setdefault(displacement.method, Stretches()).place(displacement.stamp_ns)
        if displacement.keyframe_stamp_ns != displacement.reference_stamp_ns:
            self.renewed_ns.add(displacement.keyframe_stamp_ns)
        if displacement.status != FrameStatus.OK:
            return
        self._last[displacement.method] = displacement
        size = abs(opening.opening_m) if opening is not None and opening.valid else -1.0
        if displacement.method not in self._widest or size > self._widest[displacement.method][0]:
            self._widest[displacement.method] = (size, displacement)
        for instant_s in self._instants_s:
            key, away_s = (displacement.method, instant_s), abs(self._since_start_s(displacement) - instant_s)
            if key not in self._nearest or away_s < self._nearest[key][0]:
                self._nearest[key] = (away_s, displacement)

    def _since_start_s(self, displacement: DisplacementField) -> float:
        return (displacement.stamp_ns - self._start_ns) * 1e-9

    def maps(self) -> dict[str, dict[str, DisplacementField]]:
        """method -> "widest", "last" and, for each chosen moment, "at_1.5_s" -> field."""
        return {
            method: {
                "widest": self._widest[method][1],
                "last": self._last[method],
                **{f"at_{instant_s:g}_s": self._nearest[method, instant_s][1] for instant_s in self._instants_s},
            }
            for method in sorted(self._last)
        }

    def facts(self) -> dict[str, Any]:
        """What a run should tell of keyframes after the reference, and of a clock that jumped back; nothing if none."""
        jumps = max((stamps.newest[0] for stamps in self._stamps.values()), default=0)
        counts = {"renewed keyframes": len(self.renewed_ns), "jumps back of the camera's clock": jumps}
        return {name: count for name, count in counts.items() if count}


@dataclass
class Run:
    """What a run's folder holds.

    maps: method -> label -> displacement field. facts: whatever else the run can tell (frames lost, frame rate, ...).
    """

    openings: list[CrackOpening]
    maps: dict[str, dict[str, DisplacementField]]
    reference: Reference | None
    inputs: dict[str, str]
    settings: dict[str, Any]
    facts: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    frames: FrameRecords = field(default_factory=FrameRecords)

    def save(self, folder: Path, copies: Mapping[str, Path | None] | None = None) -> None:
        """Write the folder; `copies` (name -> file, such as regions.yaml) are put beside the results.

        Raises:
            RgbdDicError: if it cannot be written.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_openings(self.openings, folder / CSV_NAME)
            self.frames.save(folder)
            np.savez_compressed(folder / MAPS_NAME, **_flat(self.maps))
            content = {
                "inputs": self.inputs,
                "facts": self.facts,
                "settings": self.settings,
                "versions": versions(),
            }
            if self.reference is not None:
                cv2.imwrite(str(folder / REFERENCE_NAME), self.reference.image)
                content["reference"] = {
                    "stamp_ns": self.reference.stamp_ns,
                    "subset_size_px": self.reference.subset_size,
                    "step_px": self.reference.step,
                }
            (folder / RUN_NAME).write_text(yaml.safe_dump(content, sort_keys=False))
            for name, path in (copies or {}).items():
                if path is not None and path.resolve() != (folder / name).resolve():
                    shutil.copyfile(path, folder / name)
        except OSError as error:
            raise RgbdDicError(f"cannot write the results to {folder}: {error.strerror}") from error

    @classmethod
    def load(cls, folder: Path) -> Run:
        """Read a folder back (the reference's subsets are not kept, only its image).

        Raises:
            RgbdDicError: if it is not a run's folder.
        """
        try:
            content = yaml.safe_load((folder / RUN_NAME).read_text())
            with np.load(folder / MAPS_NAME) as arrays:
                maps = _nested({name: arrays[name] for name in arrays.files})
        except (OSError, TypeError, ValueError, yaml.YAMLError) as error:
            raise RgbdDicError(f"{folder} is not the folder of a run (no {RUN_NAME}, {MAPS_NAME}): {error}") from error
        reference = None
        image = cv2.imread(str(folder / REFERENCE_NAME), cv2.IMREAD_GRAYSCALE)
        if image is not None and "reference" in content:
            about = content["reference"]
            reference = Reference.first(
                about["stamp_ns"],
                image,
                np.zeros((0, 2)),
                about["subset_size_px"],
                about["step_px"],
            )
        return cls(
            read_openings(folder / CSV_NAME),
            maps,
            reference,
            content["inputs"],
            content["settings"],
            content["facts"],
            content["versions"],
            FrameRecords.load(folder),
        )


def versions() -> dict[str, str]:
    """Versions of rgbd_dic and of what its numbers depend on."""
    found = {}
    for package in (
        "rgbd_dic_processing",
        "rgbd_dic_acquisition",
        "numpy",
        "scipy",
        "opencv-python-headless",
    ):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "unknown"
    return found


def _flat(maps: dict[str, dict[str, DisplacementField]]) -> dict[str, Any]:
    return {
        f"{method}/{label}/{entry.name}": np.asarray(getattr(displacement, entry.name))
        for method, labelled in maps.items()
        for label, displacement in labelled.items()
        for entry in fields(displacement)
    }


def _nested(arrays: dict[str, Any]) -> dict[str, dict[str, DisplacementField]]:
    grouped: dict[str, dict[str, dict[str, Any]]] = {}
    for name, value in arrays.items():
        method, label, entry = name.split("/")
        value = value.item() if value.ndim == 0 else value
        grouped.setdefault(method, {}).setdefault(label, {})[entry] = value
    return {
        method: {
            label: DisplacementField(**{**entries, "status": FrameStatus(entries["status"])})
            for label, entries in labelled.items()
        }
        for method, labelled in grouped.items()
    }
