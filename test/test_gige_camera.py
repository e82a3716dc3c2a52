"""A crack that a GigE Vision camera sees, measured at the end of the graph."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from gige_peers import ADDRESS, needs_aravis, our_camera, sent
from rgbd_dic_acquisition.calibration import save_calibration
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.ground_truth import save_regions
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.graph import ACQUISITION, CAMERA_TOPICS, TOF_TOPICS, GraphFiles, NodeSpec, processing_nodes
from rgbd_dic_processing.processes import GraphProcesses
from rgbd_dic_processing.supervision import supervise
from rgbd_dic_processing.watch import GraphWatch

SHOWN_HZ = 20.0  # how often there is a new image; the camera sends fewer, so that every computer keeps up
SETTINGS = {"seed": 3, "duration_s": 1.0, "timing": {"camera_rate_hz": SHOWN_HZ}}
EXPOSURE_NS = 100_000
OPENINGS = 30


@needs_aravis
@pytest.mark.timeout(280)
def test_the_opening_at_the_end_is_the_one_in_the_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "ROS_DOMAIN_ID", "71")
    flight = Flight(FlightSettings.from_mapping(SETTINGS))
    images = np.stack([flight.image(index / SHOWN_HZ, index) for index in range(21)])
    files = GraphFiles(tmp_path / "calibration.yaml", tmp_path / "regions.yaml")
    save_calibration(flight.calibration, files.calibration)
    save_regions(flight, 0.0, files.regions)
    aravis = {"transport": "gige", "address": ADDRESS, "frame_rate_hz": 5.0, "packet_bytes": 8000, "gain": 0.0}
    aravis["exposure_s"] = EXPOSURE_NS * 1e-9
    simulated = {"seed": 3, "duration_s": 1.0, "timing.camera_rate_hz": SHOWN_HZ}
    nodes = [
        *processing_nodes(files, ProcessingSettings(), ("h_pose",)),
        NodeSpec(ACQUISITION, "tof_node", (), TOF_TOPICS, parameters=_prefixed("flight", simulated)),
        NodeSpec(
            ACQUISITION,
            "camera_node",
            (),
            CAMERA_TOPICS,
            parameters={"source": "aravis", "calibration": str(files.calibration), **_prefixed("aravis", aravis)},
        ),
    ]
    answers = {"h_pose": "crack_opening"}
    processes = GraphProcesses(tmp_path / "logs", False, "")
    with our_camera(images, tmp_path, rate_hz=SHOWN_HZ), GraphWatch(answers, "", lambda _: None) as watch, processes:
        watch.subscribe()
        for node in nodes:
            processes.start(node)
        watch.wait_until_connected(nodes, processes.check)
        valid: list[CrackOpening] = []
        while len(valid) < OPENINGS:  # until the timeout of the test
            outcome = supervise(watch, processes, answers, duration_s=1.0)
            assert outcome.failure is None
            valid = [opening for opening in outcome.openings if opening.valid]
    host_ns, index = sent(tmp_path)[:, 1], sent(tmp_path)[:, 3]

    def truth_m(stamp_ns: int) -> float:
        """Of the image that was shown at the nearest time."""
        nearest = np.argmin(np.abs(host_ns - (stamp_ns - EXPOSURE_NS // 2)))
        assert abs(host_ns[nearest] - stamp_ns) < 5e6
        return flight.crack(index[nearest] / SHOWN_HZ).opening_m

    errors_m = [o.opening_m - truth_m(o.stamp_ns) + truth_m(o.reference_stamp_ns) for o in valid]
    footprint_m = flight.pose(0.0).t[2] / flight.calibration.camera.fx
    rms_m = np.sqrt(np.mean(np.square(errors_m)))
    print(f"{len(valid)} openings, RMS error {rms_m * 1e3:.4f} mm")
    assert rms_m < 0.02 * footprint_m  # as for the demonstration
    assert np.ptp([o.opening_m for o in valid]) > 0.2e-3  # there was something to measure


def _prefixed(group: str, values: dict[str, object]) -> dict[str, object]:
    return {f"{group}.{name}": value for name, value in values.items()}
