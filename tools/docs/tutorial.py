"""Runs the commands of docs/tutorial.md and writes what they print below them.

    tools/run python tools/docs/tutorial.py

In blocks that begin with ```console, a line `$ command` is run from the repository's folder, in the order of the page;
what follows it in the block is replaced by what it prints.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)


def filled(block: str) -> str:
    """A block with what its commands print now."""
    lines: list[str] = []
    for command in re.findall(r"^\$ (.*)$", block, re.MULTILINE):
        print(command, flush=True)
        environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, env=environment)
        if done.returncode != 0:
            raise SystemExit(f"{command}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        warnings = [line for line in re.split(r"[\r\n]", done.stderr) if line.startswith(("warning", "note"))]
        lines += [f"$ {command}", *warnings, *done.stdout.rstrip().splitlines()]
    return "```console\n" + "\n".join(lines).rstrip() + "\n```"


def main() -> int:
    text = PAGE.read_text()
    PAGE.write_text(BLOCK.sub(lambda found: filled(found[1]), text))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
