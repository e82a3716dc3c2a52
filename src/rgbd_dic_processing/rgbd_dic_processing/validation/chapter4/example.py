"""One laboratory as a user's run: a folder with the openings of all methods, and their maps at the widest opening."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rgbd_dic_acquisition.simulator.laboratory import Laboratory

from ...core.displacement_field import DisplacementField
from ...runs import Run
from ..running import Task
from .measuring import VARIANTS, replay
from .planes import Settled
from .recording import load_recording, regions_file
from .regions import regions_of
from .scenes import Values, open_laboratory


def process_task(**arguments: Any) -> Task:
    """The task of `process`."""
    return Task(process, arguments)


def process(folder: Path, laboratory: Values, recording: str, planes: Settled, methods: list[str], region: str) -> str:
    """Write the run; returns the name of its folder, which `rgbd-dic report` takes too.

    The maps are of one image: of those that all methods measured, the one with the widest true opening. There are maps
    of `VARIANTS` too.
    """
    arguments = {"laboratory": laboratory, "recording": recording, "planes": planes}
    name = process_task(**arguments, methods=methods, region=region).key()
    lab = open_laboratory(laboratory)
    regions_path = regions_file(folder, recording)
    regions = regions_of(lab, regions_path, region)
    measured = list(replay(folder, lab, recording, planes, regions, tuple(methods), {}))
    valid: dict[int, list[DisplacementField]] = {}
    for _, one in measured:
        if one.opening.valid:
            valid.setdefault(one.field.stamp_ns, []).append(one.field)
    times = {one.field.stamp_ns: time_s for time_s, one in measured}
    complete = [stamp for stamp, fields in valid.items() if len(fields) == len(methods)]
    widest = max(complete, key=lambda stamp: lab.crack(times[stamp]).opening_m)
    maps = {field.method: {"widest": field} for field in valid[widest]}
    for variant, (method, settings) in VARIANTS.items():
        fields = (one.field for _, one in replay(folder, lab, recording, planes, regions, (method,), settings))
        maps[variant] = {"widest": next(field for field in fields if field.stamp_ns == widest)}
    run = Run(
        [one.opening for _, one in measured],
        maps,
        load_recording(folder, recording).first,
        {"laboratory": yaml.safe_dump(laboratory), "recording": recording, "region": region},
        {},
    )
    run.save(folder / name, {"regions.yaml": regions_path})
    return name


def time_of(lab: Laboratory, field: DisplacementField) -> float:
    """The true time of a field's image [s]."""
    return next(one.time_s for one in lab.exposures() if (one.sensor, one.stamp_ns) == ("camera", field.stamp_ns))


def truth_m(lab: Laboratory, field: DisplacementField) -> np.ndarray:
    """(N, 3) true displacement of a field's subsets [m]."""
    material = lab.material(field.centres_px.astype(float), lab.reference_s)
    return lab.displacement(*material.T, time_of(lab, field))
