"""Watching over a running graph until it is done, and putting its results together."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.errors import RgbdDicError

from .core.crack import CrackOpening
from .core.settings import ProcessingSettings
from .nodes.messages import displacement_field_from_message, reference_from_message
from .processes import GraphProcesses
from .runs import MapSelection, Run
from .watch import GraphWatch

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


def collect(outcome: Outcome, bag_path: Path, settings: ProcessingSettings, inputs: dict[str, str]) -> Run:
    """The run of a graph: its openings, and the maps and the reference from the bag that it recorded."""
    by_frame = {(opening.method, opening.stamp_ns): opening for opening in outcome.openings}
    selection, facts = MapSelection(), dict(outcome.facts)
    with BagReader(bag_path) as bag:
        facts["messages recorded"] = sum(topic.count for topic in bag.topics.values())
        fields = [name for name, topic in bag.topics.items() if topic.type == "rgbd_dic_msgs/msg/DisplacementField"]
        for _, _, message in bag.messages(fields):
            field = displacement_field_from_message(message)
            selection.add(field, by_frame.get((field.method, field.stamp_ns)))
        references = bag.messages([name for name in bag.topics if name.endswith("/reference")])
        first = next((message for _, _, message in references), None)  # the one that the regions are drawn on
    reference = None if first is None else reference_from_message(first)
    facts |= selection.facts()
    return Run(outcome.openings, selection.maps(), reference, inputs, settings.as_dict(), facts)


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
