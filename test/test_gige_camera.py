"""A crack that a GigE Vision camera sees, measured at the end of the graph."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from gige_peers import ADDRESS, needs_aravis, our_camera
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.graph import ACQUISITION, CAMERA_TOPICS, TOF_TOPICS, NodeSpec, processing_nodes
from rgbd_dic_processing.processes import GraphProcesses
from rgbd_dic_processing.supervision import supervise
from rgbd_dic_processing.watch import GraphWatch
from shown_crack import EXPOSURE_NS, SHOWN_HZ, ShownCrack

OPENINGS = 30


@needs_aravis
@pytest.mark.timeout(280)
def test_the_opening_at_the_end_is_the_one_in_the_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "ROS_DOMAIN_ID", "71")
    shown = ShownCrack(tmp_path)
    # the camera sends fewer images than are shown, so that every computer keeps up
    aravis = {"transport": "gige", "address": ADDRESS, "frame_rate_hz": 5.0, "packet_bytes": 8000, "gain": 0.0}
    aravis["exposure_s"] = EXPOSURE_NS * 1e-9
    simulated = {"seed": 3, "duration_s": 1.0, "timing.camera_rate_hz": SHOWN_HZ}
    calibration = {"calibration": str(shown.files.calibration)}
    nodes = [
        *processing_nodes(shown.files, ProcessingSettings(), ("h_pose",)),
        NodeSpec(ACQUISITION, "tof_node", (), TOF_TOPICS, parameters=_prefixed("flight", simulated)),
        NodeSpec(
            ACQUISITION,
            "camera_node",
            (),
            CAMERA_TOPICS,
            parameters={"source": "aravis", **calibration, **_prefixed("aravis", aravis)},
        ),
    ]
    answers = {"h_pose": "crack_opening"}
    processes = GraphProcesses(tmp_path / "logs", False, "")
    camera = our_camera(shown.images, tmp_path, rate_hz=SHOWN_HZ)
    with camera, GraphWatch(answers, "", lambda _: None) as watch, processes:
        watch.subscribe()
        for node in nodes:
            processes.start(node)
        watch.wait_until_connected(nodes, processes.check)
        valid: list[CrackOpening] = []
        while len(valid) < OPENINGS:  # until the timeout of the test
            outcome = supervise(watch, processes, answers, duration_s=1.0)
            assert outcome.failure is None
            valid = [opening for opening in outcome.openings if opening.valid]
    rms_m = np.sqrt(np.mean(np.square(shown.errors_m(valid))))
    print(f"{len(valid)} openings, RMS error {rms_m * 1e3:.4f} mm")
    assert rms_m < shown.rms_limit_m
    assert np.ptp([o.opening_m for o in valid]) > 0.2e-3  # there was something to measure


def _prefixed(group: str, values: dict[str, object]) -> dict[str, object]:
    return {f"{group}.{name}": value for name, value in values.items()}
