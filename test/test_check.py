"""`rgbd-dic check` as a user runs it, on sensors that speak the real protocols, and on what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from autopilot_peers import Peers, free_port
from gige_peers import needs_aravis, our_camera
from live_peers import DOMAIN, NOBODY, payload
from shown_crack import SHOWN_HZ, ShownCrack
from system import rgbd_dic

pytestmark = pytest.mark.timeout(200)
COMPUTER = ("shared memory", "free disk", "speed of the disk", "processor's governor", "other programs")


def lines(text: str) -> dict[str, str]:
    """Name of each check -> its level."""
    found = [line for line in text.splitlines() if line[:4].strip() in ("pass", "WARN", "FAIL", "-")]
    return {line[6:28].strip(): line[:4].strip() for line in found}


@needs_aravis
def test_sensors_that_are_well(tmp_path: Path, shown: ShownCrack, blaze) -> None:
    peers, port = Peers(tmp_path), free_port()
    file = payload(tmp_path / "payload.yaml", shown, port)
    options = ("--payload", file, "--regions", shown.files.regions, "--out", tmp_path, "--domain", str(DOMAIN))
    try:
        with our_camera(shown.images, tmp_path, "--latch", rate_hz=SHOWN_HZ):
            peers.mavsdk(f"udpout://127.0.0.1:{port}")
            done = rgbd_dic("check", *options, "--seconds", "8")
    finally:
        peers.end()
    print(done.stdout)
    levels = lines(done.stdout)
    assert {levels[name] for name in ("calibration", "regions", "camera driver", "ToF driver", "MAVLink")} == {"pass"}
    for name in ("camera", "ToF camera", "light", "focus and texture"):
        assert levels[name] == "pass", name
    for name in ("depth of the panel", "plane", "distance", "attitude", "ROS domain"):
        assert levels[name] == "pass", name
    # what hangs on how busy this computer is, is only looked at
    timed = {f"{camera}: {what}" for camera in ("camera", "ToF camera") for what in ("rate", "frames", "clock")}
    assert {*timed, "pairing", "TIMESYNC", *COMPUTER} <= set(levels)
    assert done.returncode == ("FAIL" in levels.values())


@needs_aravis
def test_sensors_that_are_not_there(tmp_path: Path, shown: ShownCrack, blaze) -> None:
    blaze["present"] = 0
    file = payload(tmp_path / "payload.yaml", shown, free_port(), NOBODY)
    done = rgbd_dic("check", "--payload", file, "--regions", shown.files.regions, "--domain", str(DOMAIN))
    assert done.returncode == 1
    levels = lines(done.stdout)
    assert {levels[name] for name in ("camera", "ToF camera", "attitude")} == {"FAIL"}
    assert {levels[name] for name in ("light", "plane", "pairing")} == {"-"}
    assert f"no camera answers at {NOBODY}" in done.stdout and "-> " in done.stdout


def test_nothing_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The computer alone is looked at."""
    monkeypatch.chdir(tmp_path)
    done = rgbd_dic("check", "--domain", str(DOMAIN))
    levels = lines(done.stdout)
    assert {levels[name] for name in ("calibration", "regions", "sensors")} == {"-"}
    assert set(COMPUTER) <= set(levels)
    assert done.returncode == ("FAIL" in levels.values())


def test_a_payload_that_is_malformed(tmp_path: Path) -> None:
    file = tmp_path / "payload.yaml"
    file.write_text(
        "camera_node: {ros__parameters: {source: aravis, aravis: {exposure_s: never}}}\n"
        "tof_node: {ros__parameters: {source: gentl}}\n"
    )
    done = rgbd_dic("check", "--payload", file)
    assert done.returncode == 1 and "exposure_s" in done.stderr
