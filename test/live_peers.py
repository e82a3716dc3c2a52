"""A payload of fake sensors that speak the real protocols: its payload.yaml, and the ToF camera's scenes."""

from __future__ import annotations

from pathlib import Path

import yaml
from fake_blaze import SERIAL, producer
from gige_peers import ADDRESS
from shown_crack import EXPOSURE_NS, ShownCrack

DOMAIN = 42
NOBODY = "127.0.0.99"  # where no camera is


def payload(path: Path, shown: ShownCrack, port: int | None = None, address: str = ADDRESS) -> Path:
    """payload.yaml of the fake sensors; without a port, without an autopilot."""
    aravis = {"transport": "gige", "address": address, "frame_rate_hz": 5.0, "packet_bytes": 8000, "gain": 0.0}
    aravis["exposure_s"] = EXPOSURE_NS * 1e-9
    nodes = {
        "camera_node": {"source": "aravis", "calibration": str(shown.files.calibration), "aravis": aravis},
        "tof_node": {"source": "gentl", "tof": {"producer": str(producer()), "device": SERIAL}},
    }
    if port is not None:
        nodes["mavlink_node"] = {"link": {"url": f"udpin://127.0.0.1:{port}"}}
    path.write_text(yaml.safe_dump({"/**": {name: {"ros__parameters": values} for name, values in nodes.items()}}))
    return path
