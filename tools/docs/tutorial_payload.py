"""Stands in for one's own payload in docs/tutorial.md: sensors that speak the real protocols, until Ctrl-C.

    tools/run python tools/docs/tutorial_payload.py FOLDER

A GigE Vision camera and a ToF camera behind a GenTL producer see the same simulated crack, which opens and closes; an
autopilot sends its attitude. The folder gets payload.yaml, calibration.yaml and regions.yaml. Needs what `make
setup-camera` and `make setup-tof` install, aravis-tools' libraries and a C++ compiler.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import threading
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "src/rgbd_dic_acquisition/test"), str(ROOT / "test")]
from autopilot_peers import Peers, free_port  # noqa: E402
from fake_blaze import SERIAL, FakeBlaze, producer  # noqa: E402
from gige_peers import ADDRESS, our_camera, why_not  # noqa: E402
from shown_crack import EXPOSURE_NS, SHOWN_HZ, ShownCrack  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    if missing := why_not():
        raise SystemExit(missing)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    hidden = folder / "sensors"
    shutil.rmtree(hidden, ignore_errors=True)
    (hidden / "tof").mkdir(parents=True)
    shown, port = ShownCrack(folder), free_port()
    blaze = FakeBlaze((hidden / "tof").resolve())
    blaze.show(shown.depth_frames(), SHOWN_HZ, shown.flight.calibration.tof)
    cti = shutil.copy(producer((hidden / "tof").resolve()), hidden / "fake_blaze.cti")
    aravis = {"transport": "gige", "address": ADDRESS, "packet_bytes": 8000, "socket_buffer_bytes": 200_000}
    aravis |= {"frame_rate_hz": 10.0, "exposure_s": EXPOSURE_NS * 1e-9, "gain": 0.0}
    nodes = {
        "camera_node": {"source": "aravis", "calibration": str(shown.files.calibration), "aravis": aravis},
        "tof_node": {"source": "gentl", "tof": {"producer": str(cti), "device": SERIAL}},
        "mavlink_node": {"link": {"url": f"udpin://127.0.0.1:{port}"}},
    }
    content = {"/**": {name: {"ros__parameters": values} for name, values in nodes.items()}}
    (folder / "payload.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    peers = Peers(hidden)
    try:
        with our_camera(shown.images, hidden, "--latch", rate_hz=SHOWN_HZ):
            peers.mavsdk(f"udpout://127.0.0.1:{port}")
            files = ", ".join(sorted(path.name for path in folder.iterdir() if path.is_file()))
            print(f"{folder}: {files}; the sensors run until Ctrl-C", flush=True)
            ended.wait()
    finally:
        peers.end()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
