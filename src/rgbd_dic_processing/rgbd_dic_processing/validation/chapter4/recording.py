"""The DIC of a laboratory's images, kept: all that the later steps of the method need of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...core.correlation import CorrelationSettings
from ...core.regions_file import load_regions
from ...core.search import SeedSource
from ...core.settings import RenewalSettings, SearchSettings
from ...core.status import FrameStatus
from ...core.subset_field import Reference, SubsetField
from ...core.tracking import SubsetTracking
from ..running import Task
from .scenes import Values, open_laboratory

SETTINGS = ("rgbd_dic_processing.core.settings",)  # their values are arguments of the task
ENUMS = {"status": FrameStatus, "seed_source": SeedSource}


def recording_task(laboratory: Values) -> Task:
    """The task that renders and tracks all images of a laboratory."""
    settings = {
        "correlation": CorrelationSettings(threads=1).as_dict(),
        "search": SearchSettings().as_dict(),
        "renewal": RenewalSettings().as_dict(),
    }
    return Task(record, {"laboratory": laboratory, "settings": settings}, without=SETTINGS)


def record(folder: Path, laboratory: Values, settings: dict[str, dict[str, Any]]) -> str:
    """Track all images; returns the name of the recording, which `load_recording` takes."""
    lab = open_laboratory(laboratory)
    name = Task(record, {"laboratory": laboratory, "settings": settings}, without=SETTINGS).key()
    regions_path = regions_file(folder, name)
    regions_path.parent.mkdir(parents=True, exist_ok=True)
    regions_path.write_text(yaml.safe_dump(lab.regions))
    tracking = SubsetTracking(
        lab.calibration.camera,
        load_regions(regions_path),
        CorrelationSettings(**settings["correlation"]),
        SearchSettings(**settings["search"]),
        RenewalSettings(**settings["renewal"]),
    )
    fields = [
        tracking.track(exposure.stamp_ns, lab.image(exposure.time_s, exposure.index))
        for exposure in lab.exposures()
        if exposure.sensor == "camera"
    ]
    reference = dataclasses.replace(tracking.reference, regions=None)  # each replay brings its own
    _save(_fields_file(folder, name), reference, fields)
    return name


class Recording:
    """In the place of the pipeline's `SubsetTracking`.

    Attributes:
        reference: as there; known from the first image on.
    """

    def __init__(self, reference: Reference, fields: list[SubsetField]) -> None:
        self.first, self.reference, self.fields = reference, None, fields
        self._by_stamp = {field.stamp_ns: field for field in fields}

    def track(self, stamp_ns: int, image: None, reason: str = "") -> SubsetField:
        self.reference = self.first
        return self._by_stamp[stamp_ns]


def regions_file(folder: Path, name: str) -> Path:
    """regions.yaml of a recording."""
    return folder / "recordings" / f"{name}_regions.yaml"


def load_recording(folder: Path, name: str) -> Recording:
    """Of `record`."""
    with np.load(_fields_file(folder, name)) as stored:
        arrays = dict(stored)
    reference = _from_arrays(Reference, {key[2:]: value[0] for key, value in arrays.items() if key.startswith("r_")})
    columns = {key[2:]: value for key, value in arrays.items() if key.startswith("f_")}
    count = len(columns["stamp_ns"])
    return Recording(
        reference, [_from_arrays(SubsetField, {k: v[i] for k, v in columns.items()}) for i in range(count)]
    )


def _fields_file(folder: Path, name: str) -> Path:
    return folder / "recordings" / f"{name}.npz"


def _save(path: Path, reference: Reference, fields: list[SubsetField]) -> None:
    arrays = {f"r_{key}": value for key, value in _as_arrays([reference]).items()}
    arrays |= {f"f_{key}": value for key, value in _as_arrays(fields).items()}
    unfinished = path.with_suffix(".part.npz")
    np.savez_compressed(unfinished, **arrays)
    unfinished.replace(path)


def _as_arrays(entries: list[Any]) -> dict[str, np.ndarray]:
    """Field of a dataclass -> its values in all entries; without fields that are None."""
    names = [field.name for field in dataclasses.fields(entries[0]) if getattr(entries[0], field.name) is not None]
    return {name: np.array([getattr(one, name) for one in entries]) for name in names}


def _from_arrays(kind: type, values: dict[str, Any]) -> Any:
    plain = {key: value.item() if value.ndim == 0 else value for key, value in values.items()}
    return kind(**{key: ENUMS[key](value) if key in ENUMS else value for key, value in plain.items()})
