"""rgbd-dic regions: a page in the browser on which the regions are drawn, on a bag or an image; saves regions.yaml."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.calibration import load_calibration

from ..core.regions_file import read_entries
from ..core.settings import load_settings
from .options import beside

PORT = 8420


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("regions", help="draw the regions in a browser", description=__doc__)
    parser.add_argument("source", type=Path, help="bag (a directory, or a .mcap file), or an image file")
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
    add_server(parser)
    parser.set_defaults(run=run)


def add_server(parser: argparse.ArgumentParser) -> None:
    """Where the pages are served."""
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen on; any but the loopback asks for a token (default: %(default)s)",
    )
    parser.add_argument("--port", type=int, default=PORT, help="0 takes a free one (default: %(default)s)")


def _above_zero(text: str) -> float:
    value = float(text)
    if not 0 < value < 256:
        raise argparse.ArgumentTypeError("must be above 0 and below 256 grey levels")
    return value


def run(options: argparse.Namespace) -> int:
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
