"""rgbd-dic import: folders of images and depth files become a bag."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("import", help="folders of images become a bag", description=__doc__)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    raise NotImplementedError
