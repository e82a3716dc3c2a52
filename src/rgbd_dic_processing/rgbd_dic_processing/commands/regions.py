"""rgbd-dic regions: a page in the browser on which the regions are drawn, on a bag or an image; saves regions.yaml."""

from __future__ import annotations

import argparse
import asyncio
import os
import tempfile
from pathlib import Path
from typing import Any

import yaml
from rgbd_dic_acquisition.calibration import load_calibration

from ..core.regions_file import read_entries
from ..core.settings import load_settings
from .options import beside

PORT = 8420


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("regions", help="draw the regions in a browser", description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("source", type=Path, nargs="?", help="bag (a directory, or a .mcap file), or an image file")
    source.add_argument(
        "--live", action="store_true", help="the running graph: draw on its newest image, and see the live page as well"
    )
    parser.add_argument(
        "--regions", type=Path, help="regions.yaml to begin with (default: the file of --out, or the one in the bag)"
    )
    parser.add_argument("--calibration", type=Path, help="calibration.yaml (default: the one in the bag's directory)")
    parser.add_argument("--settings", type=Path, help="settings.yaml, grouped by stage (docs/parameters.md)")
    parser.add_argument("--out", type=Path, default=Path("regions.yaml"), help="file to save (default: regions.yaml)")
    parser.add_argument(
        "--noise",
        type=_above_zero,
        default=1.0,
        metavar="GREY",
        help="noise of the camera's pixels, for the uncertainty that the page expects [grey levels] (default: 1)",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen on; any but the loopback asks for a token (default: %(default)s)",
    )
    parser.add_argument("--port", type=int, default=PORT, help="0 takes a free one (default: %(default)s)")
    parser.add_argument("--namespace", default="", help="with --live: that of the graph (default: none)")
    parser.add_argument("--domain", type=int, help="with --live: ROS domain (default: ROS_DOMAIN_ID, else 0)")
    parser.set_defaults(run=run)


def _above_zero(text: str) -> float:
    value = float(text)
    if not 0 < value < 256:
        raise argparse.ArgumentTypeError("must be above 0 and below 256 grey levels")
    return value


def run(options: argparse.Namespace) -> int:
    return _run_live(options) if options.live else _run_offline(options)


def _run_live(options: argparse.Namespace) -> int:
    """The operator_node in this process, with what the options say as its parameters."""
    from ..nodes.operator_node import main  # ROS is imported only by what needs it

    if options.domain is not None:
        os.environ["ROS_DOMAIN_ID"] = str(options.domain)
    settings = load_settings(options.settings).as_dict()
    parameters = {
        "operator": {"host": options.host, "port": options.port, "noise": options.noise},
        "regions_out": str(options.out.resolve()),
        **{name: settings[name] for name in ("correlation", "plane", "compensation", "crack")},
    }
    if options.calibration is not None:
        parameters["calibration_file"] = str(options.calibration.resolve())
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump({"/**": {"ros__parameters": parameters}}, file)
        file.flush()
        words = ["--ros-args", "--params-file", file.name]
        if options.namespace:
            words += ["-r", f"__ns:=/{options.namespace.strip('/')}"]
        return main(words, _announce)


def _run_offline(options: argparse.Namespace) -> int:
    from ..pages.access import Access  # the server is imported only by what needs it
    from ..pages.drawing import Drawing
    from ..pages.regions_page import RegionsPage
    from ..pages.server import make_app, serve

    settings, access = load_settings(options.settings), Access.on(options.host, options.port)
    is_bag = options.source.is_dir() or options.source.suffix == ".mcap"
    if is_bag:
        calibration_path = options.calibration or beside(options.source, "calibration.yaml")
        drawing = Drawing.of_bag(options.source, calibration_path, settings, options.noise)
    else:
        camera = load_calibration(options.calibration).camera if options.calibration else None
        drawing = Drawing.of_file(options.source, camera, settings, options.noise)
    given = options.regions or (options.out if options.out.exists() else None)
    given = given or (beside(options.source, "regions.yaml") if is_bag else None)
    start = {} if given is None else read_entries(given)
    page = RegionsPage(drawing, options.out, start)
    asyncio.run(serve(make_app(access, page.routes(), start="/regions"), access, _announce))
    return 0


def _announce(address: str) -> None:
    print(f"open {address}   (Ctrl-C ends)", flush=True)
