"""Watching over a running graph until it is done, and putting its results together."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.errors import RgbdDicError

from .core.crack import CrackMeasurement, CrackOpening
from .core.displacement_field import DisplacementField
from .core.frame_quality import QualityRecord
from .core.opening_budget import OpeningBudget
from .core.regions_file import load_regions
from .core.settings import ProcessingSettings
from .core.subset_field import Reference
from .frame_files import FrameRecords
from .graph import GraphFiles
from .nodes.messages import (
    displacement_field_from_message,
    frame_pair_from_message,
    plane_from_message,
    reference_from_message,
    subset_field_from_message,
)
from .processes import GraphProcesses
from .runs import MapSelection, Run
from .watch import GraphWatch

KINDS = ("Reference", "SubsetField", "FramePair", "PlaneStamped", "DisplacementField")
QUIET_S = 5.0  # the graph has answered all it will when nothing was published for this long after the bag's end


@dataclass(frozen=True)
class Outcome:
    """What a graph published while it ran, what was measured of it, and why it ended early, if it did."""

    openings: list[CrackOpening]
    facts: dict[str, Any]
    failure: RgbdDicError | None


def supervise(
    watch: GraphWatch,
    processes: GraphProcesses,
    answers: dict[str, str],
    playing: subprocess.Popen | None = None,
    images: int | None = None,
    duration_s: float | None = None,
    sensors: tuple[str, ...] = (),
) -> Outcome:
    """Follow a connected graph until its player has ended and all is answered, the time is over, or Ctrl-C.

    Args:
        answers: method -> topic of its openings.
        playing: the player; None for live sensors.
        images: how many it will play.
        sensors: names of nodes that are started again if they are killed.
    """
    failure, end = None, time.monotonic() + duration_s if duration_s is not None else float("inf")
    try:
        while (playing is None or playing.poll() is None) and time.monotonic() < end:
            for name in processes.revive(sensors):
                print(f"{name} was killed, and is started again", file=sys.stderr, flush=True)
            processes.check()
            watch.spin(0.1)
        wanted = images * len(answers) if images is not None else 0
        while len(watch.openings) < wanted and time.monotonic() - watch.last_heard < QUIET_S:
            processes.check()
            watch.spin(0.1)
        processes.check()
    except KeyboardInterrupt:
        print("ending; what was measured is kept", file=sys.stderr)
    except RgbdDicError as error:
        failure = error
    took_s = watch.last_heard - watch.first_heard
    return Outcome(watch.openings, _facts(watch.openings, tuple(answers), images, took_s), failure)


def collect(
    outcome: Outcome,
    bag_path: Path,
    settings: ProcessingSettings,
    inputs: dict[str, str],
    files: GraphFiles,
    instants_s: Sequence[float] = (),
) -> Run:
    """The run of a graph: its openings, and the maps, the reference and what the frames were like from the bag that it
    recorded."""
    by_frame = {(opening.method, opening.stamp_ns): opening for opening in outcome.openings}
    selection, facts = MapSelection(instants_s), dict(outcome.facts)
    quality, budgets = QualityRecord(), []
    with BagReader(bag_path) as bag:
        facts["messages recorded"] = sum(topic.count for topic in bag.topics.values())
        topics = {
            kind: [name for name, topic in bag.topics.items() if topic.type.endswith(f"/{kind}")] for kind in KINDS
        }
        references = [reference_from_message(message) for _, _, message in bag.messages(topics["Reference"])]
        crack = CrackOfReference(files, settings, references)
        for name, _, message in bag.messages([name for names in topics.values() for name in names]):
            if name in topics["DisplacementField"]:
                field = displacement_field_from_message(message)
                selection.add(field, by_frame.get((field.method, field.stamp_ns)))
                opening, parts = crack.measure_with_parts(field)
                if opening.valid:
                    budgets.append(OpeningBudget.of(field, opening, parts))
            elif name in topics["SubsetField"]:
                quality.add(subset_field_from_message(message))
            elif name in topics["FramePair"]:
                quality.add(None, pairs=[frame_pair_from_message(message)])
            elif name in topics["PlaneStamped"]:
                quality.add(None, planes=[plane_from_message(message)])
    facts |= selection.facts()
    return Run(
        outcome.openings,
        selection.maps(),
        references[0] if references else None,  # the one that the regions are drawn on
        inputs,
        settings.as_dict(),
        facts,
        frames=FrameRecords(quality.images(), quality.planes, budgets),
    )


class CrackOfReference:
    """Measures the opening of each field with the zones of the reference that it counts from."""

    def __init__(self, files: GraphFiles, settings: ProcessingSettings, references: Sequence[Reference]):
        camera, drawn = load_calibration(files.calibration).camera, load_regions(files.regions).crack
        self._first = CrackMeasurement(camera, drawn, settings.crack)
        self._of = {
            reference.stamp_ns: CrackMeasurement(camera, reference.regions.crack, settings.crack)
            for reference in references
            if reference.regions is not None and reference.regions.crack is not None
        }

    def measure_with_parts(self, field: DisplacementField) -> tuple[CrackOpening, NDArray[np.float64]]:
        return self._of.get(field.reference_stamp_ns, self._first).measure_with_parts(field)


def _facts(openings: list[CrackOpening], methods: tuple[str, ...], images: int | None, took_s: float) -> dict[str, Any]:
    """Images, frames lost, frame rate and latency of the first method."""
    answered = Counter(opening.method for opening in openings)
    facts: dict[str, Any] = {"images": images if images is not None else answered[methods[0]]}
    if images is not None:
        facts["frames lost"] = sum(images - answered[method] for method in methods)
    if took_s > 0:
        facts["frame rate [Hz]"] = round((answered[methods[0]] - 1) / took_s, 1)
    latencies = [opening.latency_s for opening in openings if opening.method == methods[0]]
    if latencies:
        median, high = np.percentile(latencies, (50, 95))
        facts["latency [ms]"] = (
            f"{median * 1e3:.0f} median, {high * 1e3:.0f} at the 95th percentile, {max(latencies) * 1e3:.0f} at most"
        )
    return facts
