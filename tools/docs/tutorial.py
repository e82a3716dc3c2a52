"""Runs the commands of docs/tutorial.md and writes what they print below them.

    tools/run python tools/docs/tutorial.py

In blocks that begin with ```console, a line `$ command` is run from the repository's folder, in the order of the page;
what follows it in the block is replaced by what it prints. One that ends with `&` goes on until the end of the page;
its first line is waited for.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)


def environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}


@contextmanager
def in_background(command: str) -> Iterator[str]:
    """The first line that a command prints; it and all that it started are ended afterwards."""
    process = subprocess.Popen(
        ["bash", "-c", f"exec {command}"],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=environment(),
        start_new_session=True,
    )
    try:
        yield process.stdout.readline().rstrip()
    finally:
        os.killpg(process.pid, signal.SIGINT)
        process.wait(30)


def printed(command: str) -> list[str]:
    """What a command prints, with the warnings and notes before it."""
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, env=environment())
    if done.returncode != 0:
        raise SystemExit(f"{command}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    warnings = [line for line in re.split(r"[\r\n]", done.stderr) if line.startswith(("warning", "note"))]
    return [*warnings, *done.stdout.replace(f"{ROOT}/", "").rstrip().splitlines()]


def filled(block: str, running: ExitStack) -> str:
    """A block with what its commands print now."""
    lines: list[str] = []
    for command in re.findall(r"^\$ (.*)$", block, re.MULTILINE):
        print(command, flush=True)
        lines.append(f"$ {command}")
        if command.endswith("&"):
            lines.append(running.enter_context(in_background(command.rstrip("& "))))
        else:
            lines += printed(command)
    return "```console\n" + "\n".join(lines).rstrip() + "\n```"


def main() -> int:
    text = PAGE.read_text()
    with ExitStack() as running:
        text = BLOCK.sub(lambda found: filled(found[1], running), text)
    PAGE.write_text(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
