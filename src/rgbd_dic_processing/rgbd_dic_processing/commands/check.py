"""rgbd-dic check: the checklist before take-off, each item with its remedy (docs/payload.md)."""

from __future__ import annotations

import argparse
import os
from collections import Counter
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.payload import load_payload

from ..checking.checklist import Plan, checklist
from ..checking.finding import Finding, Level
from ..core.settings import load_settings
from ..pages.settings import OperatorSettings

PAYLOAD = Path("payload.yaml")


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("check", help="the checklist before take-off", description=__doc__)
    parser.add_argument(
        "--payload", type=Path, help=f"parameters of the sensor nodes (default: {PAYLOAD}, if it is there)"
    )
    parser.add_argument("--calibration", type=Path, help="calibration.yaml (default: that of the payload)")
    parser.add_argument("--regions", type=Path, help="regions.yaml, drawn on an image from where the flight begins")
    parser.add_argument("--settings", type=Path, help="settings.yaml, grouped by stage (docs/parameters.md)")
    parser.add_argument(
        "--out", type=Path, default=Path(), help="folder that is to be recorded into (default: the current one)"
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="planned length (default: %(default)s) [min]")
    parser.add_argument(
        "--seconds", type=float, default=5.0, help="how long the sensors are listened to (default: %(default)s) [s]"
    )
    parser.add_argument(
        "--noise",
        type=float,
        default=OperatorSettings.noise,
        help="noise of the camera's pixels (default: %(default)s) [grey levels]",
    )
    parser.add_argument("--domain", type=int, help="ROS domain of the flight (default: ROS_DOMAIN_ID, else 0)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    path = options.payload or (PAYLOAD if PAYLOAD.exists() else None)
    payload = None if path is None else load_payload(path)
    domain = int(os.environ.get("ROS_DOMAIN_ID", "0")) if options.domain is None else options.domain
    plan = Plan(
        payload,
        options.calibration or (payload.calibration if payload else None),
        options.regions,
        load_settings(options.settings),
        options.out,
        options.minutes,
        options.seconds,
        domain,
        options.noise,
    )
    levels: Counter[Level] = Counter()
    for finding in checklist(plan):
        levels[finding.level] += 1
        print(_lines(finding), flush=True)
    print(
        f"\n{levels[Level.PASS]} passed, {levels[Level.WARN]} with a warning, {levels[Level.FAIL]} failed, "
        f"{levels[Level.NOT_CHECKED]} not checked"
    )
    return 1 if levels[Level.FAIL] else 0


def _lines(finding: Finding) -> str:
    line = f"{finding.level.value:>4}  {finding.name:<22}  {finding.text}"
    return f"{line}\n{'':>4}  {'':<22}  -> {finding.remedy}" if finding.remedy else line
