"""rgbd-dic up: start the node graph on a bag or on the simulated sensors, record it, and keep its results."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.crack import CrackOpening
from ..core.regions import load_regions
from ..core.settings import ProcessingSettings
from ..graph import (
    SENSOR_TOPICS,
    GraphFiles,
    NodeSpec,
    all_topics,
    opening_topic,
    player,
    processing_nodes,
    recorder,
    simulated_sensors,
)
from ..processes import GraphProcesses
from ..recorded import check_topics, has_clouds
from ..results import read_truth
from ..runs import MapSelection, Run
from .options import add_measurement, beside, finish, measurement_settings, required_file
from .progress import progress

QUIET_S = 5.0  # the graph has answered all it will when nothing was published for this long after the bag's end
WINDOW = 16  # images under way; more than a missing ToF frame makes the pairing wait for


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("up", help="start the node graph", description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("bag", type=Path, nargs="?", help="bag to play: a directory, or a .mcap file")
    source.add_argument("--simulated", action="store_true", help="run on the simulated camera and ToF sensor")
    add_measurement(parser)
    parser.add_argument(
        "--rate", type=_above_zero, default=1.0, help="speed of the bag (default: 1, as recorded); above 0"
    )
    parser.add_argument(
        "--as-fast-as-possible",
        action="store_true",
        help="play as fast as the graph answers, and lose no frame",
    )
    parser.add_argument("--duration", type=float, metavar="S", help="end after this time [s] (default: Ctrl-C)")
    parser.add_argument("--namespace", default="", help="pushed on all names (default: none)")
    parser.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID, else 0)")
    parser.set_defaults(run=run)


def _above_zero(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError("must be above 0; for the highest speed use --as-fast-as-possible")
    return value


def run(options: argparse.Namespace) -> int:
    settings, methods = measurement_settings(options)
    if options.domain is not None:
        os.environ["ROS_DOMAIN_ID"] = str(options.domain)
    output = options.out / "bag"
    if output.exists():
        raise RgbdDicError(f"{output} exists already: choose another --out, or remove it first")
    if options.namespace and not options.namespace.startswith("/"):
        options.namespace = f"/{options.namespace}"
    source = options.bag or options.out
    files = GraphFiles(
        required_file(options.calibration, source, "calibration.yaml"),
        required_file(options.regions, source, "regions.yaml"),
    )
    load_calibration(files.calibration)
    if load_regions(files.regions).crack is None:
        raise RgbdDicError(f"{files.regions}: the graph needs an entry 'crack' (see docs/files.md)")
    truth_path = options.truth or (beside(options.bag, "truth.csv") if options.bag else None)
    if truth_path is not None:
        read_truth(truth_path)  # a malformed one is refused before the flight, not after
    use_points = False
    if options.bag:
        with BagReader(options.bag) as bag:
            check_topics(bag)
            use_points = has_clouds(bag)
            recorded = {name.lstrip("/"): topic.count for name, topic in bag.topics.items()}
        if "camera/image_raw" not in recorded:
            raise RgbdDicError(f"{options.bag}: its topics are in a namespace; the graph plays bags without one only")
        images, topics = recorded["camera/image_raw"], tuple(t for t in SENSOR_TOPICS if t in recorded)
    nodes = processing_nodes(files, settings, methods, use_points)
    if not options.bag:
        images, topics = None, ()
        nodes += simulated_sensors()
    nodes.append(recorder(output, tuple(dict.fromkeys((*topics, *all_topics(nodes))))))
    openings, facts, failure = _run_graph(options, nodes, topics, methods, images)
    if failure is not None and not openings:
        raise failure
    inputs = {
        "bag": str(options.bag or "simulated sensors"),
        "regions": str(files.regions),
        "calibration": str(files.calibration),
        "methods": ", ".join(methods),
    }
    result = _collect(openings, output, settings, inputs, facts)
    code = finish(result, options.out, files.regions, files.calibration, truth_path)
    if failure is not None:
        raise failure
    return code


def _run_graph(
    options: argparse.Namespace,
    nodes: list[NodeSpec],
    topics: tuple[str, ...],
    methods: tuple[str, ...],
    images: int | None,
) -> tuple[list[CrackOpening], dict[str, Any], RgbdDicError | None]:
    """Start the nodes, play or wait, end them; the openings, what was measured of the graph, and what it failed of."""
    from ..watch import GraphWatch

    failure = None
    answers = {method: opening_topic(method, methods) for method in methods}
    with progress(images, "image") as bar:

        def show(opening: CrackOpening) -> None:
            if opening.method == methods[0]:
                bar.update()
                value = f"{opening.opening_m * 1e3:+.3f} mm" if opening.valid else f"invalid: {opening.reason}"
                bar.set_postfix_str(f"opening {value}", refresh=False)

        processes = GraphProcesses(options.out / "logs", options.bag is not None, options.namespace)
        with GraphWatch(answers, options.namespace, show) as watch, processes:
            watch.refuse_second_graph(nodes)
            watch.subscribe()
            for node in nodes:
                processes.start(node)
            watch.wait_until_connected(nodes, processes.check)
            started = time.monotonic()
            try:
                if options.bag:
                    fast = options.as_fast_as_possible
                    spec = player(
                        options.bag,
                        topics,
                        nodes,
                        tuple(answers.values()) if fast else (),
                        0.0 if fast else options.rate,
                        WINDOW,
                    )
                    playing = processes.start(spec)
                    while playing.poll() is None and not _over(options, started):
                        processes.check()
                        watch.spin(0.1)
                    wanted = images * len(methods)
                    while len(watch.openings) < wanted and time.monotonic() - watch.last_heard < QUIET_S:
                        processes.check()
                        watch.spin(0.1)
                else:
                    while not _over(options, started):
                        processes.check()
                        watch.spin(0.1)
                processes.check()
            except KeyboardInterrupt:
                print("ending; what was measured is kept", file=sys.stderr)
            except RgbdDicError as error:
                failure = error
            took_s = watch.last_heard - watch.first_heard
    return watch.openings, _facts(watch.openings, methods, images, took_s), failure


def _over(options: argparse.Namespace, started: float) -> bool:
    return options.duration is not None and time.monotonic() - started > options.duration


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


def _collect(
    openings: list[CrackOpening],
    bag_path: Path,
    settings: ProcessingSettings,
    inputs: dict[str, str],
    facts: dict[str, Any],
) -> Run:
    """The run of a graph: its openings, and the maps and the reference from the recorded bag."""
    from ..nodes.messages import displacement_field_from_message, reference_from_message

    by_frame = {(opening.method, opening.stamp_ns): opening for opening in openings}
    selection, reference = MapSelection(), None
    with BagReader(bag_path) as bag:
        facts["messages recorded"] = sum(topic.count for topic in bag.topics.values())
        fields = [name for name, topic in bag.topics.items() if topic.type == "rgbd_dic_msgs/msg/DisplacementField"]
        for _, _, message in bag.messages(fields):
            field = displacement_field_from_message(message)
            selection.add(field, by_frame.get((field.method, field.stamp_ns)))
        for _, _, message in bag.messages([n for n in bag.topics if n.endswith("/reference")]):
            reference = reference_from_message(message)
    return Run(openings, selection.maps(), reference, inputs, settings.as_dict(), facts)
