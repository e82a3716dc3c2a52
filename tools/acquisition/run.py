"""`make test-acquisition`: a flight through the real protocols into a bag, and the bag through the method.

A GigE Vision camera, a ToF camera behind a GenTL producer and an autopilot on MAVSDK play one rendered flight. The
nodes read, measure and record it; each peer fails once and comes back. Then the recording is held against what the
peers wrote down that they sent, and measured. The exit code is 1 if a frame was lost outside the faults, if a stamp is
beyond its stated uncertainty, if the error of the opening is more than the simulated noise explains, or if a fault was
told or mended too late.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from rendered_flight import RenderedFlight
from rgbd_dic_acquisition.simulator.flight import FlightSettings
from rgbd_dic_processing.core.settings import ProcessingSettings, load_settings

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tools"), str(ROOT / "tools/docs"), str(ROOT / "src/rgbd_dic_acquisition/test")]
from accounting import account  # noqa: E402 - what they import is found by the line above
from blocks import replace_block  # noqa: E402
from fake_blaze import compiler  # noqa: E402
from flight_peers import CAMERA, TOF  # noqa: E402
from gige_peers import ADDRESS, why_not  # noqa: E402
from recorded import Recorded  # noqa: E402
from replay import replay  # noqa: E402
from report import failures, tables  # noqa: E402
from session import NODES, Flown, Plan, fly  # noqa: E402

OUT = ROOT / "results/acquisition"
DOCUMENT = ROOT / "docs/payload.md"
LIVE = ROOT / "src/rgbd_dic_processing/config/live.yaml"


@dataclass(frozen=True)
class Size:
    """Of the session: what is rendered, what is measured, how long it flies."""

    name: str
    flight: dict
    step: int
    plan: Plan


# Neither side moves out of the panel's plane: seen at a slant, that would look like opening (docs/method.md).
FLIGHT = {"duration_s": 2.0, "crack": {"out_of_plane_m": 0.0}}
FULL = Size(
    "full",
    {
        **FLIGHT,
        "camera": {"width_px": 1440, "height_px": 1080, "supersampling": 3},
        "tof": {"width_px": 640, "height_px": 480},
    },
    26,  # 1,500 subsets
    Plan(well_s=12.0, gone_s=4.0),
)
QUICK = Size("quick", FLIGHT, 10, Plan(well_s=3.5, gone_s=2.0))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="20 s at 480 x 360 and 160 x 120 pixels; nothing is timed")
    parser.add_argument("--keep", action="store_true", help="keep the recording")
    parser.add_argument("--judge", action="store_true", help="do not fly; judge the recording that was kept")
    parser.add_argument(
        "--document", action="store_true", help="write the tables into docs/payload.md if nothing failed"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=OUT,
        help="folder for the session, of 8 GB and 130 MB/s (default: results/acquisition)",
    )
    given = parser.parse_args()
    if missing := lacking():
        print(missing, file=sys.stderr)
        return 2
    size = QUICK if given.quick else FULL
    os.environ.setdefault("ROS_DOMAIN_ID", "72")
    folder = (given.out / size.name).resolve()
    if not given.judge:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    rendered = RenderedFlight(FlightSettings.from_mapping(size.flight), OUT / f"rendered_{size.name}")
    in_flight, afterwards = (with_step(load_settings(path), size.step) for path in (LIVE, None))
    flown = Flown.load(folder) if given.judge else fly(rendered, in_flight, size.plan, folder)
    recorded = Recorded(folder, flown, rendered)
    accounts = {peer: account(peer, folder, flown, recorded, rendered) for peer in NODES}
    if not accounts[CAMERA].index:
        print(f"FAILED: no image was recorded: does another program use {ADDRESS}?", file=sys.stderr)
        return 1
    measured = replay(folder, rendered, afterwards, flown, accounts[CAMERA], accounts[TOF])
    report = tables(flown, recorded, accounts, measured)
    (folder / "report.md").write_text(report)
    print(f"\n{report}")
    if not (given.keep or given.judge):
        shutil.rmtree(folder / "bag")
    failed = failures(accounts, measured, timed=not given.quick)
    for failure in failed:
        print(f"FAILED: {failure}", file=sys.stderr)
    if given.document and not failed:
        DOCUMENT.write_text(replace_block(DOCUMENT.read_text(), "acquisition", report))
    return 1 if failed else 0


def with_step(settings: ProcessingSettings, step: int) -> ProcessingSettings:
    return replace(settings, correlation=replace(settings.correlation, step=step))


def lacking() -> str:
    """What must be installed first, in words; empty if nothing."""
    if reason := why_not():
        return f"{reason} (docs/payload.md)"
    if compiler() is None:
        return "no C++ compiler: apt-get install g++"
    modules = {"harvesters": "make setup-tof", "mavsdk": "pip install mavsdk==4.1.0"}
    return "; ".join(f"{name} is missing: {how}" for name, how in modules.items() if not importlib.util.find_spec(name))


if __name__ == "__main__":
    raise SystemExit(main())
