"""rgbd-dic up: start the node graph on a bag, on real or simulated sensors, record it, and keep its results."""

from __future__ import annotations

import argparse
import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.crack import CrackOpening
from ..core.regions_file import load_regions
from ..graph import (
    ALL,
    SHARING,
    NodeSpec,
    all_topics,
    foxglove_server,
    opening_topic,
    operator_page,
    player,
    processing_nodes,
    recorder,
    viewer,
)
from ..processes import GraphProcesses
from ..results import read_truth
from ..sensor_states import SensorStates
from .options import add_measurement, finish, measurement_settings
from .progress import progress
from .regions import PORT
from .up_sources import Source, source_of

if TYPE_CHECKING:
    from ..supervision import Outcome

FOXGLOVE_PORT = 8765
DRAWN_NAME = "regions_drawn.yaml"  # what the page saves, beside the regions.yaml that the run began with
WINDOW = 16  # images under way; more than a missing ToF frame makes the pairing wait for


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("up", help="start the node graph", description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("bag", type=Path, nargs="?", help="bag to play: a directory, or a .mcap file")
    source.add_argument("--live", action="store_true", help="run on the sensors of --payload, until Ctrl-C")
    source.add_argument("--simulated", action="store_true", help="run on the simulated camera and ToF sensor")
    parser.add_argument(
        "--payload",
        type=Path,
        default=Path("payload.yaml"),
        help="for --live: parameters of the sensor nodes (docs/payload.md; default: %(default)s)",
    )
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
    parser.add_argument(
        "--page",
        type=int,
        nargs="?",
        const=PORT,
        metavar="PORT",
        help=f"serve the live page (default: not; without a number: port {PORT})",
    )
    parser.add_argument(
        "--page-host",
        default="127.0.0.1",
        help="its address; any but the loopback asks for a token (default: %(default)s)",
    )
    parser.add_argument(
        "--viewers",
        action="store_true",
        help="publish, and record, what Foxglove and rviz show (docs/viewers.md)",
    )
    parser.add_argument(
        "--foxglove",
        type=int,
        nargs="?",
        const=FOXGLOVE_PORT,
        metavar="PORT",
        help=f"--viewers, and serve Foxglove on this computer (default: not; without a number: port {FOXGLOVE_PORT})",
    )
    parser.add_argument(
        "--composed",
        nargs="?",
        const=ALL,
        default="",
        choices=tuple(SHARING),
        metavar="WHICH",
        help="run the nodes that work on every image in one process; with 'after_dic', in one but for dic_node, which "
        "is quicker where two cores are free (default: each node is a process of its own)",
    )
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
    source = source_of(options, settings)
    if load_regions(source.files.regions).crack is None:
        raise RgbdDicError(f"{source.files.regions}: the graph needs an entry 'crack' (see docs/files.md)")
    if source.truth is not None:
        read_truth(source.truth)  # a malformed one is refused before the flight, not after
    nodes = [
        *processing_nodes(source.files, settings, methods, source.use_points, live=bool(source.sensors)),
        *source.sensors,
    ]
    addresses = []
    if options.viewers or options.foxglove is not None:
        nodes.append(viewer(source.files, source.use_points))
    if options.foxglove is not None:
        addresses.append(foxglove_address(options.foxglove))
        nodes.append(foxglove_server(options.foxglove))
    if options.page is not None:
        addresses.append(page_address(options.page_host, options.page))
        drawn = options.out / DRAWN_NAME
        nodes.append(operator_page(options.page_host, options.page, source.files, settings, drawn))
    nodes.append(recorder(output, tuple(dict.fromkeys((*source.topics, *all_topics(nodes))))))
    from ..supervision import collect  # ROS is imported only by what needs it

    answers = {method: opening_topic(method, methods) for method in methods}
    outcome = _run(options, source, nodes, answers, addresses)
    if outcome.failure is not None and not outcome.openings:
        raise outcome.failure
    inputs = {
        "bag": source.label,
        "regions": str(source.files.regions),
        "calibration": str(source.files.calibration),
        "methods": ", ".join(methods),
    }
    result = collect(outcome, output, settings, inputs, source.files, options.maps_at)
    code = finish(result, options.out, source.files.regions, source.files.calibration, source.truth)
    if outcome.failure is not None:
        raise outcome.failure
    return code


def page_address(host: str, port: int) -> str:
    """The address of the page; its node gets the token, if one is needed, through the environment."""
    from ..pages.access import TOKEN_VARIABLE, Access

    access = Access.on(host, port)
    if access.token is not None:
        os.environ[TOKEN_VARIABLE] = access.token
    return access.address(port)


def foxglove_address(port: int) -> str:
    """What to open in Foxglove.

    Raises:
        RgbdDicError: if what serves it is not installed.
    """
    if find_spec("foxglove") is None:
        raise RgbdDicError("--foxglove needs the package foxglove-sdk: make setup-viewers installs it")
    return f"ws://127.0.0.1:{port}"


def _run(
    options: argparse.Namespace,
    source: Source,
    nodes: list[NodeSpec],
    answers: dict[str, str],
    addresses: list[str],
) -> Outcome:
    """Start the nodes and, on a bag, the player; show the openings as they come; end them."""
    from ..supervision import supervise
    from ..watch import GraphWatch

    first = next(iter(answers))
    sensors = tuple(sensor.node_name for sensor in source.sensors)
    with progress(source.images, "image") as bar:

        def show(opening: CrackOpening) -> None:
            if opening.method == first:
                bar.update()
                value = f"{opening.opening_m * 1e3:+.3f} mm" if opening.valid else f"invalid: {opening.reason}"
                bar.set_postfix_str(f"opening {value}", refresh=False)

        states = SensorStates(sensors, lambda text: bar.write(text, file=sys.stderr))
        processes = GraphProcesses(options.out / "logs", options.bag is not None, options.namespace)
        with GraphWatch(answers, options.namespace, show, states.take) as watch, processes:
            watch.refuse_second_graph(nodes)
            watch.subscribe()
            processes.start_all(nodes, options.composed)
            watch.wait_until_connected(nodes, processes.check)
            for address in addresses:
                print(f"open {address}", flush=True)
            if source.sensors:
                bar.write(f"{', '.join(sensors)} run: Ctrl-C ends the flight", file=sys.stderr)
                return supervise(watch, processes, answers, duration_s=options.duration, sensors=sensors)
            fast = options.as_fast_as_possible
            waited_for = tuple(answers.values()) if fast else ()
            spec = player(options.bag, source.topics, nodes, waited_for, 0.0 if fast else options.rate, WINDOW)
            return supervise(watch, processes, answers, processes.start(spec), source.images, options.duration)
