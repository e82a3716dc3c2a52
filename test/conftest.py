"""What the tests of the whole system share: a short flight, and bags with something wrong in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rgbd_dic_acquisition.bag import BagReader, BagWriter
from rgbd_dic_acquisition.simulator.flight import FlightSettings
from rgbd_dic_acquisition.simulator.flight_bag import simulate_flight

if TYPE_CHECKING:
    from fake_blaze import FakeBlaze
    from shown_crack import ShownCrack

Edit = Callable[[str, int, Any], Any]


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of simulated flight: 30 images, 10 ToF frames, the crack opening as in the first half second."""
    path = tmp_path_factory.mktemp("flight") / "short"
    simulate_flight(FlightSettings.from_mapping({"duration_s": 0.5}), path)
    return path


@pytest.fixture
def edited(flight: Path, tmp_path: Path) -> Callable[[Edit], Path]:
    """Makes a copy of the flight in which `edit(topic, index on that topic, message)` changed the messages.

    What it returns is written; None leaves the message out. `rename` maps topics to those they are written to.
    """

    def make(edit: Edit, rename: Mapping[str, str] | None = None) -> Path:
        path = tmp_path / "edited"
        with BagReader(flight) as source, BagWriter(path) as bag:
            seen: dict[str, int] = {}
            for topic, log_time_ns, message in source.messages():
                index = seen.get(topic, 0)
                seen[topic] = index + 1
                changed = edit(topic, index, message)
                if changed is not None:
                    to, kind = (rename or {}).get(topic, topic), source.topics[topic].type
                    bag.add_topic(to, kind, transient_local=topic == "/tf_static")
                    bag.write_message(to, log_time_ns, changed)
        for name in ("regions.yaml", "calibration.yaml"):
            (path / name).write_text((flight / name).read_text())
        return path

    return make


@pytest.fixture
def shown(tmp_path: Path) -> ShownCrack:
    """What the fake sensors of a payload see."""
    from shown_crack import ShownCrack  # needs Aravis where it is there

    return ShownCrack(tmp_path)


@pytest.fixture
def blaze(tmp_path: Path, shown: ShownCrack, monkeypatch: pytest.MonkeyPatch) -> FakeBlaze:
    """The fake ToF camera, which sees the same; found by the environment."""
    from fake_blaze import FakeBlaze, compiler
    from shown_crack import SHOWN_HZ

    if compiler() is None:
        pytest.skip("no C++ compiler: apt-get install g++")
    pytest.importorskip("harvesters", reason="harvesters is missing: make setup-tof")
    (tmp_path / "tof").mkdir()
    made = FakeBlaze(tmp_path / "tof")
    made.show(shown.depth_frames(), SHOWN_HZ, shown.flight.calibration.tof)
    for name, value in made.environment.items():
        monkeypatch.setenv(name, value)
    return made
