"""rgbd-dic simulate: a flight in front of a cracking panel, or the laboratory of the thesis, as a bag with its exact
truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import yaml
from rgbd_dic_acquisition.errors import SettingsError

from .progress import progress


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("simulate", help="make a bag with known truth", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="directory of the bag; must not exist")
    parser.add_argument(
        "--preset",
        choices=("sample", "laboratory", "laboratory_hard"),
        default="sample",
        help="what to start from: the flight of bags/ (sample, the default), the bent panel of the thesis' chapter 4 "
        "(laboratory), or that with everything that can go wrong (laboratory_hard)",
    )
    parser.add_argument("--settings", type=Path, help="YAML with what differs from the preset (docs/parameters.md)")
    parser.add_argument(
        "--duration", type=float, metavar="S", help="length of the recording [s] (default: 2, a laboratory's: 10)"
    )
    parser.add_argument("--seed", type=int, help="of all random numbers (default: 1); the same gives the same bytes")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from rgbd_dic_acquisition.simulator.flight import FlightSettings
    from rgbd_dic_acquisition.simulator.flight_bag import simulate_flight
    from rgbd_dic_acquisition.simulator.laboratory import laboratory_settings
    from rgbd_dic_acquisition.simulator.laboratory_bag import simulate_laboratory

    values: dict[str, Any] = {}
    if options.settings is not None:
        try:
            values = yaml.safe_load(options.settings.read_text()) or {}
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise SettingsError(f"cannot read settings {options.settings}: {error}") from error
    for name, value in (("duration_s", options.duration), ("seed", options.seed)):
        if value is not None:
            values[name] = value
    where = str(options.settings or "simulate")
    with progress(None, "exposure") as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        if options.preset == "sample":
            summary = simulate_flight(FlightSettings.from_mapping(values, where), options.out, show)
        else:
            summary = simulate_laboratory(laboratory_settings(options.preset, values, where), options.out, show)
    print(f"{summary.path}: {sum(summary.counts.values())} messages")
    for topic, count in sorted(summary.counts.items()):
        print(f"  {count:6d}  {topic}")
    return 0
