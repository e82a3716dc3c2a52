"""What goes wrong while the graph runs: nothing stays behind, and what was measured is kept."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from system import SAMPLE, environment, rgbd_dic

pytestmark = pytest.mark.timeout(120)


def processes_of(out: Path) -> dict[str, int]:
    """Nodes that run with their parameters in this folder: name -> process id."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if "--params-file" in words and str(out) in words[words.index("--params-file") + 1]:
                found[Path(words[words.index("--params-file") + 1]).stem] = int(entry.name)
    return found


def wait_for(condition, what: str, timeout_s: float = 60) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.1)


def start(out: Path, domain: int, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        ["rgbd-dic", "up", SAMPLE, "--domain", str(domain), "--out", out, *options],
        env=environment(),
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )


def playing(out: Path) -> bool:
    log = out / "logs" / "player_node.log"
    return log.exists() and "answered" in log.read_text()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_ended_from_outside_leaves_no_node_and_keeps_the_results(tmp_path: Path, number: int) -> None:
    out = tmp_path / "run"
    graph = start(out, 75, "--rate", "0.12")
    wait_for(lambda: playing(out), "the player")
    assert len(processes_of(out)) == 7
    graph.send_signal(number)
    output, _ = graph.communicate(timeout=40)
    assert graph.returncode == 0 and "h_pose" in output
    assert processes_of(out) == {}
    assert rgbd_dic("info", out / "bag").returncode in (0, 1)  # the recording was finished, so it can be read
    with (out / "crack_opening.csv").open() as file:
        assert 1 <= len(list(csv.DictReader(file))) < 120


def test_killed_with_no_chance_to_say_goodbye_leaves_no_node(tmp_path: Path) -> None:
    out = tmp_path / "run"
    graph = start(out, 79, "--rate", "0.2")
    wait_for(lambda: playing(out), "the player")
    graph.kill()
    graph.communicate()
    wait_for(lambda: not processes_of(out), "the nodes to end", 20)


def test_a_killed_node_is_named_and_what_was_measured_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "run"
    graph = start(out, 76, "--rate", "0.2")
    wait_for(lambda: playing(out), "the player")
    os.kill(processes_of(out)["crack_opening_node"], signal.SIGKILL)
    _, message = graph.communicate(timeout=40)
    assert graph.returncode == 1
    assert "crack_opening_node ended with exit code -9" in message
    assert processes_of(out) == {}
    with (out / "crack_opening.csv").open() as file:
        assert len(list(csv.DictReader(file))) >= 1


def test_second_graph_in_the_same_domain_is_refused(tmp_path: Path) -> None:
    graph = start(tmp_path / "first", 77, "--rate", "0.02")
    try:
        wait_for(lambda: playing(tmp_path / "first"), "the player")
        second = rgbd_dic("up", SAMPLE, "--domain", "77", "--out", tmp_path / "second")
        assert second.returncode == 1 and "already run in ROS domain 77" in second.stderr
    finally:
        graph.send_signal(signal.SIGTERM)
        graph.communicate(timeout=40)
