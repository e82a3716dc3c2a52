"""rgbd-dic up: start the node graph on a bag or on the simulated sensors, record it, and keep its results."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.crack import CrackOpening
from ..core.regions_file import load_regions
from ..graph import (
    SENSOR_TOPICS,
    GraphFiles,
    NodeSpec,
    all_topics,
    opening_topic,
    operator_page,
    player,
    processing_nodes,
    recorder,
    simulated_sensors,
)
from ..processes import GraphProcesses
from ..recorded import check_topics, has_clouds
from ..results import read_truth
from .options import add_measurement, beside, complete_regions, finish, measurement_settings, required_file
from .progress import progress
from .regions import PORT

if TYPE_CHECKING:
    from ..supervision import Outcome

DRAWN_NAME = "regions_drawn.yaml"  # what the page saves, beside the regions.yaml that the run began with
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
    calibration_path = required_file(options.calibration, source, "calibration.yaml")
    calibration = load_calibration(calibration_path)
    regions_path = required_file(options.regions, source, "regions.yaml")
    if options.bag:
        with BagReader(options.bag) as bag:
            regions_path = complete_regions(bag, calibration, regions_path, settings, options.out)
    files = GraphFiles(calibration_path, regions_path)
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
    address = ""
    if options.page is not None:
        address = page_address(options.page_host, options.page)
        nodes.append(operator_page(options.page_host, options.page, files, settings, options.out / DRAWN_NAME))
    nodes.append(recorder(output, tuple(dict.fromkeys((*topics, *all_topics(nodes))))))
    from ..supervision import collect  # ROS is imported only by what needs it

    answers = {method: opening_topic(method, methods) for method in methods}
    outcome = _run(options, nodes, topics, answers, images, address)
    if outcome.failure is not None and not outcome.openings:
        raise outcome.failure
    inputs = {
        "bag": str(options.bag or "simulated sensors"),
        "regions": str(files.regions),
        "calibration": str(files.calibration),
        "methods": ", ".join(methods),
    }
    result = collect(outcome, output, settings, inputs)
    code = finish(result, options.out, files.regions, files.calibration, truth_path)
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


def _run(
    options: argparse.Namespace,
    nodes: list[NodeSpec],
    topics: tuple[str, ...],
    answers: dict[str, str],
    images: int | None,
    address: str,
) -> Outcome:
    """Start the nodes and, on a bag, the player; show the openings as they come; end them."""
    from ..supervision import supervise
    from ..watch import GraphWatch

    first = next(iter(answers))
    with progress(images, "image") as bar:

        def show(opening: CrackOpening) -> None:
            if opening.method == first:
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
            if address:
                print(f"open {address}", flush=True)
            if not options.bag:
                return supervise(watch, processes, answers, duration_s=options.duration)
            fast = options.as_fast_as_possible
            waited_for = tuple(answers.values()) if fast else ()
            spec = player(options.bag, topics, nodes, waited_for, 0.0 if fast else options.rate, WINDOW)
            return supervise(watch, processes, answers, processes.start(spec), images, options.duration)
