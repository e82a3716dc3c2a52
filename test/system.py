"""The system under test: where it is, and how a user runs it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "bags" / "sample"


def environment() -> dict[str, str]:
    """Of a process that starts anew, as from a shell."""
    return {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}


def rgbd_dic(*arguments: str | Path, timeout_s: float = 200) -> subprocess.CompletedProcess[str]:
    """Run the tool as a user would; its output is text."""
    command = ["rgbd-dic", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, env=environment())
