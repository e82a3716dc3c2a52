"""Everything that can be wrong with what a user gives: refused with the thing and the remedy named, or, for a bad
frame inside a good bag, an invalid row with its reason while the run goes on."""

from __future__ import annotations

import csv
import dataclasses
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from rgbd_dic_acquisition.bag import BagReader, BagWriter
from rgbd_dic_acquisition.simulator.flight_bag import START_NS
from system import SAMPLE, rgbd_dic


def refused(*arguments: str | Path) -> str:
    """Run, expect a refusal; its message."""
    done = rgbd_dic(*arguments)
    assert done.returncode == 1, (done.returncode, done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    return done.stderr


def rows(out: Path, method: str = "h_pose") -> list[dict[str, str]]:
    with (out / "crack_opening.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["method"] == method]


def regions_with(flight: Path, tmp_path: Path, **changes: object) -> Path:
    content = yaml.safe_load((flight / "regions.yaml").read_text()) | changes
    path = tmp_path / "regions.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_not_mcap(tmp_path: Path) -> None:
    path = tmp_path / "thesis.mcap"
    path.write_bytes(b"%PDF-1.7" + bytes(1000))
    message = refused("process", path, "--regions", SAMPLE / "regions.yaml", "--out", tmp_path / "out")
    assert "thesis.mcap is not an MCAP file" in message and "give an MCAP bag" in message


def test_missing_bag(tmp_path: Path) -> None:
    assert "check the path" in refused("info", tmp_path / "nothing")


def test_truncated_and_repaired(tmp_path: Path) -> None:
    bag = tmp_path / "cut"
    bag.mkdir()
    (bag / "cut_0.mcap").write_bytes((SAMPLE / "sample_0.mcap").read_bytes()[:3_000_000])
    for name in ("regions.yaml", "calibration.yaml"):
        shutil.copy(SAMPLE / name, bag)
    message = refused("process", bag, "--out", tmp_path / "out")
    assert "cut_0.mcap is cut short" in message and "rgbd-dic info --repair" in message
    repaired = tmp_path / "whole"
    done = rgbd_dic("info", "--repair", bag, "--out", repaired)
    assert done.returncode == 0 and "/camera/image_raw" in done.stdout, done.stderr
    assert re.search(rf"repaired: \d+ messages into {repaired}; lost: 0\.\d+ MB", done.stdout)
    assert rgbd_dic("process", repaired, "--out", tmp_path / "out").returncode == 0
    with BagReader(repaired) as reader:
        assert len(rows(tmp_path / "out")) == reader.topics["/camera/image_raw"].count > 15
    assert "exists already" in refused("info", "--repair", bag, "--out", repaired)


@pytest.mark.parametrize("command", ["process", "up"])
def test_without_needed_topic(edited, tmp_path: Path, command: str) -> None:
    bag = edited(lambda topic, index, message: None if topic == "/tof/depth/image_raw" else message)
    message = refused(command, bag, "--out", tmp_path / "out")
    assert "no topic tof/depth/image_raw" in message and "/camera/image_raw" in message


def test_unknown_encoding(edited, tmp_path: Path) -> None:
    """All images unreadable: the run ends with every row invalid, its reason in each, and exit code 3."""

    def colour(topic, index, message):
        return dataclasses.replace(message, encoding="bayer_rggb8") if topic == "/camera/image_raw" else message

    done = rgbd_dic("process", edited(colour), "--out", tmp_path / "out")
    assert done.returncode == 3, done.stderr
    assert len(rows(tmp_path / "out")) == 30
    assert {row["valid"] for row in rows(tmp_path / "out")} == {"0"}
    assert all("BAD_IMAGE" in row["reason"] and "bayer_rggb8" in row["reason"] for row in rows(tmp_path / "out"))


def test_uncalibrated_camera_info(edited, tmp_path: Path) -> None:
    def uncalibrated(topic, index, message):
        return dataclasses.replace(message, k=np.zeros(9)) if topic == "/camera/camera_info" else message

    bag = edited(uncalibrated)
    (bag / "calibration.yaml").unlink()
    message = refused("process", bag, "--out", tmp_path / "out")
    assert "uncalibrated" in message and "calibration.yaml" in message
    message = refused("up", bag, "--out", tmp_path / "up")
    assert "no calibration.yaml" in message and "--calibration" in message


def test_calibration_from_the_bag(flight: Path, edited, tmp_path: Path) -> None:
    """Without calibration.yaml the camera_infos and /tf_static of the bag give the same numbers."""
    bag = edited(lambda topic, index, message: message)
    (bag / "calibration.yaml").unlink()
    for source, out in ((flight, "with"), (bag, "without")):
        assert rgbd_dic("process", source, "--out", tmp_path / out).returncode == 0
    for mine, theirs in zip(rows(tmp_path / "with"), rows(tmp_path / "without"), strict=True):
        assert float(mine["opening_mm"]) == pytest.approx(float(theirs["opening_mm"]), abs=1e-5)


def test_regions_outside_the_image(flight: Path, tmp_path: Path) -> None:
    path = regions_with(flight, tmp_path, panel=[[10, 10], [900, 10], [900, 300], [10, 300]])
    message = refused("process", flight, "--regions", path, "--out", tmp_path / "out")
    assert "panel has the point (900, 10), outside the image of 480 x 360 px" in message


def test_zone_without_subsets(flight: Path, tmp_path: Path) -> None:
    crack = {"point": [210, 187], "direction": [0, 1], "size": [2, 2], "gap": 3}
    path = regions_with(flight, tmp_path, crack=crack)
    message = refused("process", flight, "--regions", path, "--out", tmp_path / "out")
    assert "zone holds no subset centre" in message and "smaller step" in message


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"panel": [[1, 2]]}, "panel: expected at least 3 points"),
        ({"crack": {"point": [1, 2]}}, "crack: give either left and right"),
        ({"x_axis": [[1, 2], [1, 2]]}, "x_axis: expected two different points"),
        ({"pannel": []}, "unknown entry pannel"),
    ],
)
def test_malformed_regions(flight: Path, tmp_path: Path, changes: dict, said: str) -> None:
    path = regions_with(flight, tmp_path, **changes)
    message = refused("process", flight, "--regions", path, "--out", tmp_path / "out")
    assert said in message and "regions.yaml" in message


@pytest.mark.parametrize(
    "text, said",
    [
        ("correlation: {subset_size: 30}", "must be odd"),
        ("correlation: {min_zncc: 1.5}", "at most 1"),
        ("plane: {min_points: many}", "expected int"),
        ("compensation: {method: h_4d}", "choose one of h_pose"),
        ("corelation: {}", "unknown group corelation"),
        ("plane: {points: 3}", "unknown setting points"),
    ],
)
def test_setting_out_of_range(flight: Path, tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    message = refused("process", flight, "--settings", path, "--out", tmp_path / "out")
    assert (said in message and "settings.yaml" in message) or "Settings." in message


def test_bad_frames_inside_a_good_bag(edited, tmp_path: Path) -> None:
    """Image 20 has another size, 23 too few bytes, 26 is black; ToF frame 2 is empty, 4 has an unknown encoding.

    A method that needs the frame's own plane loses the images of the bad ToF frames; h_pose does not.
    """

    def spoil(topic, index, message):
        if topic == "/camera/image_raw" and index == 20:
            return dataclasses.replace(message, height=10, data=message.data[: 10 * message.step])
        if topic == "/camera/image_raw" and index == 23:
            return dataclasses.replace(message, data=message.data[:-7])
        if topic == "/camera/image_raw" and index == 26:
            return dataclasses.replace(message, data=np.zeros_like(message.data))
        if topic == "/tof/depth/image_raw" and index == 2:
            return dataclasses.replace(message, data=np.zeros_like(message.data))
        if topic == "/tof/depth/image_raw" and index == 4:
            return dataclasses.replace(message, encoding="yuv422")
        return message

    done = rgbd_dic("process", edited(spoil), "--method", "h_pose,h_3d", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    pose, rigid = rows(tmp_path / "out", "h_pose"), rows(tmp_path / "out", "h_3d")
    invalid = {index: row["reason"] for index, row in enumerate(pose) if row["valid"] == "0"}
    assert set(invalid) == {20, 23, 26}
    assert "480 x 10 px" in invalid[20] and "must have" in invalid[23] and invalid[26].startswith("LOST")
    assert all(row["opening_mm"] == "nan" for index, row in enumerate(pose) if index in invalid)
    reasons = [row["reason"] for index, row in enumerate(rigid) if index not in invalid and row["valid"] == "0"]
    assert sum("no valid pixel" in reason for reason in reasons) == 3
    assert sum("yuv422" in reason for reason in reasons) == 3
    assert len(reasons) == 6


def test_damaged_messages_inside_a_good_bag(flight: Path, tmp_path: Path) -> None:
    """Image 20 is cut short inside the bag itself: its row is invalid, all others are as before.

    The panel is taken for flat, because what is known of its shape comes from all images before."""
    with BagReader(flight) as source, BagWriter(tmp_path / "damaged") as bag:
        images = 0
        for topic, kind, log_time_ns, data in source.raw_messages():
            images += topic == "/camera/image_raw"
            cut = topic == "/camera/image_raw" and images == 21
            bag.add_topic(topic, kind, transient_local=topic == "/tf_static")
            bag.write(topic, log_time_ns, data[:1000] if cut else data)
    regions, calibration = flight / "regions.yaml", flight / "calibration.yaml"
    (tmp_path / "flat.yaml").write_text("compensation: {bow_m: 0}")
    options = ("--regions", regions, "--calibration", calibration, "--settings", tmp_path / "flat.yaml")
    assert rgbd_dic("process", tmp_path / "damaged", *options, "--out", tmp_path / "out").returncode == 0
    assert rgbd_dic("process", flight, *options, "--out", tmp_path / "whole").returncode == 0
    damaged, whole = rows(tmp_path / "out"), rows(tmp_path / "whole")
    assert damaged[20]["valid"] == "0" and "cannot be read" in damaged[20]["reason"]
    for mine, theirs in zip(damaged[:20] + damaged[21:], whole[:20] + whole[21:], strict=True):
        assert mine["valid"] == "1" and float(mine["opening_mm"]) == pytest.approx(
            float(theirs["opening_mm"]), abs=1e-4
        )


def test_nan_depth(edited, tmp_path: Path) -> None:
    """Depth in metres, all NaN: nothing has a plane, so no row is valid, and each says why."""

    def nan(topic, index, message):
        if topic != "/tof/depth/image_raw":
            return message
        data = np.full(message.height * message.width, np.nan, np.float32).tobytes()
        return dataclasses.replace(
            message, encoding="32FC1", step=4 * message.width, data=np.frombuffer(data, np.uint8)
        )

    done = rgbd_dic("process", edited(nan), "--out", tmp_path / "out")
    assert done.returncode == 3, done.stderr
    assert all(
        "NO_REFERENCE_PLANE" in row["reason"] and "no valid pixel" in row["reason"] for row in rows(tmp_path / "out")
    )


def test_no_depth_for_a_while(edited, tmp_path: Path) -> None:
    """Three ToF frames in a row are missing: h_3d says so for the images between, h_pose goes on."""
    bag = edited(lambda topic, index, message: None if topic.startswith("/tof/depth") and 3 <= index < 6 else message)
    assert rgbd_dic("process", bag, "--method", "h_pose,h_3d", "--out", tmp_path / "out").returncode == 0
    assert all(row["valid"] == "1" for row in rows(tmp_path / "out", "h_pose"))
    missing = [row for row in rows(tmp_path / "out", "h_3d") if row["valid"] == "0"]
    assert 8 <= len(missing) <= 10  # 200 ms without a ToF frame, of which 2 x 30 ms are near enough to one
    assert all(row["reason"].startswith("NO_DEPTH_FRAME") and row["depth_offset_s"] == "nan" for row in missing)


def test_zones_that_leave_the_image(flight: Path, edited, tmp_path: Path) -> None:
    """The panel jumps to the left for five images, until the left zone is out of view, and comes back."""
    jump_px, away = 200, range(20, 25)

    def moved(topic, index, message):
        if topic != "/camera/image_raw" or index not in away:
            return message
        pixels = np.asarray(message.data).reshape(message.height, message.step)
        pixels = np.hstack([pixels[:, jump_px:], np.zeros((message.height, jump_px), np.uint8)])
        return dataclasses.replace(message, data=pixels.ravel())

    for source, out in ((flight, "whole"), (edited(moved), "moved")):
        assert rgbd_dic("process", source, "--out", tmp_path / out).returncode == 0
    whole, seen = rows(tmp_path / "whole"), rows(tmp_path / "moved")
    assert [index for index, row in enumerate(seen) if row["valid"] == "0"] == list(away)
    assert all("left zone" in seen[index]["reason"] or "fixed region" in seen[index]["reason"] for index in away)
    for mine, theirs in zip(seen, whole, strict=True):
        if mine["valid"] == "1":
            assert float(mine["opening_mm"]) == pytest.approx(float(theirs["opening_mm"]), abs=2e-3)


def jumping(by: dict[str, float], after_s: float = 0.3):
    """An edit: the clocks of some sensors (`camera`, `tof`) jump by so many seconds; the recorder's does not."""

    def edit(topic, index, message):
        by_s = by.get(topic.split("/")[1], 0.0)
        stamp_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec if hasattr(message, "header") else 0
        if not by_s or stamp_s - START_S < after_s:
            return message
        ns = round(stamp_s * 1e9) + round(by_s * 1e9)
        stamp = dataclasses.replace(message.header.stamp, sec=ns // 10**9, nanosec=ns % 10**9)
        return dataclasses.replace(message, header=dataclasses.replace(message.header, stamp=stamp))

    return edit


START_S = START_NS * 1e-9


@pytest.mark.parametrize("by_s", [-0.25, -100.0, 0.4])
def test_clocks_that_jump(flight: Path, edited, tmp_path: Path, by_s: float) -> None:
    """Both clocks jump: after one image that says so, measuring goes on, and what is measured is what it was."""
    bag = edited(jumping({"camera": by_s, "tof": by_s}))
    for source, out in ((flight, "whole"), (bag, "jumped")):
        done = rgbd_dic("process", source, "--method", "h_pose,h_3d", "--out", tmp_path / out)
        assert done.returncode == 0, done.stderr
    assert ("jumps back of the camera's clock: 1" in (tmp_path / "jumped" / "summary.md").read_text()) == (by_s < 0)
    for method, lost in (("h_pose", by_s < 0), ("h_3d", 3)):
        whole, jumped = rows(tmp_path / "whole", method), rows(tmp_path / "jumped", method)
        invalid = [row for row in jumped if row["valid"] == "0"]
        assert len(jumped) == len(whole) and len(invalid) <= lost
        said = ("not later", "near enough", "no image near it")  # of the image itself, its ToF frame, that one's image
        assert all(any(words in row["reason"] for words in said) for row in invalid)
        for mine, theirs in zip(jumped, whole, strict=True):
            if mine["valid"] == "1":
                # near the jump another ToF frame may be the nearest, and the averaged plane lack one
                limit_mm = 0.002 + 3 * float(mine["u_opening_mm"])
                assert float(mine["opening_mm"]) == pytest.approx(float(theirs["opening_mm"]), abs=limit_mm)


def test_graph_and_clocks_that_jump(edited, tmp_path: Path) -> None:
    """The graph has the same rows as the offline tool, with the same reasons."""
    bag = edited(jumping({"camera": -0.25, "tof": -0.25}))
    options = (bag, "--method", "h_pose,h_3d", "--out")
    assert rgbd_dic("process", *options, tmp_path / "offline").returncode == 0
    done = rgbd_dic("up", *options, tmp_path / "online", "--as-fast-as-possible", "--domain", "84")
    assert done.returncode == 0, done.stderr
    for method in ("h_pose", "h_3d"):
        online, offline = rows(tmp_path / "online", method), rows(tmp_path / "offline", method)
        assert len(online) == len(offline) == 30
        for mine, theirs in zip(online, offline, strict=True):
            assert mine | {"latency_s": "nan"} == theirs


@pytest.mark.parametrize("by_s", [-0.5, 0.5])
@pytest.mark.parametrize("sensor", ["camera", "tof"])
def test_clock_of_one_sensor_jumps(edited, tmp_path: Path, sensor: str, by_s: float) -> None:
    """What needs a ToF frame of its own says that there is none; h_pose goes on with the plane it knows."""
    bag = edited(jumping({sensor: by_s}, after_s=0.25))
    done = rgbd_dic("process", bag, "--method", "h_pose,h_3d", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    late = [row["reason"] for row in rows(tmp_path / "out") if row["valid"] == "0"]
    assert len(late) == (sensor == "camera" and by_s < 0) and all("not later" in reason for reason in late)
    after = rows(tmp_path / "out", "h_3d")[18:]
    assert len(after) == 12 and all(row["reason"].startswith("NO_DEPTH_FRAME") for row in after)


def test_recorder_whose_clock_runs_back(flight: Path, tmp_path: Path) -> None:
    """Its log times order the bag, so nothing could put the messages right again."""
    with BagReader(flight) as source, BagWriter(tmp_path / "back") as bag:
        middle = (source.start_ns + source.end_ns) // 2
        for topic, kind, log_time_ns, data in source.raw_messages():
            bag.add_topic(topic, kind, transient_local=topic == "/tf_static")
            bag.write(topic, log_time_ns - (10**10 if log_time_ns > middle else 0), data)
    message = refused("process", tmp_path / "back", "--regions", flight / "regions.yaml", "--out", tmp_path / "out")
    assert "clock of the computer that recorded it ran back by 9.9 s" in message


def test_no_depth_for_a_second(edited, tmp_path: Path) -> None:
    """ToF frames end after 0.2 s: h_3d has none from then on, h_pose has the plane of the first ones."""
    bag = edited(lambda topic, index, message: None if topic.startswith("/tof/depth") and index >= 4 else message)
    assert rgbd_dic("process", bag, "--method", "h_pose,h_3d", "--out", tmp_path / "out").returncode == 0
    assert all(row["valid"] == "1" for row in rows(tmp_path / "out"))
    assert all("NO_DEPTH_FRAME" in row["reason"] for row in rows(tmp_path / "out", "h_3d")[13:])


def test_swapped_calibrations(flight: Path, tmp_path: Path) -> None:
    """The intrinsics of the two sensors exchanged: refused frame by frame, as the images are of another size."""
    content = yaml.safe_load((flight / "calibration.yaml").read_text())
    content["camera"], content["tof"] = content["tof"], content["camera"]
    path = tmp_path / "swapped.yaml"
    path.write_text(yaml.safe_dump(content))
    done = rgbd_dic("process", flight, "--calibration", path, "--out", tmp_path / "out")
    assert done.returncode == 3 or "outside the image" in done.stderr, done.stderr
    if done.returncode == 3:
        assert all("the calibrated camera has" in row["reason"] for row in rows(tmp_path / "out"))


def test_swapped_streams(edited, tmp_path: Path) -> None:
    """Each sensor's images on the other's topic: neither can be taken for the other's."""
    swapped = {"/camera/image_raw": "/tof/depth/image_raw", "/tof/depth/image_raw": "/camera/image_raw"}
    bag = edited(lambda topic, index, message: message, rename=swapped)
    done = rgbd_dic("process", bag, "--out", tmp_path / "out")
    assert done.returncode == 3, done.stderr
    assert all(row["reason"].startswith("BAD_IMAGE") and "mono8" in row["reason"] for row in rows(tmp_path / "out"))


def test_recorded_bag_is_never_overwritten(flight: Path, tmp_path: Path) -> None:
    """The output of an earlier run is never overwritten."""
    (tmp_path / "out" / "bag").mkdir(parents=True)
    message = refused("up", flight, "--out", tmp_path / "out")
    assert "exists already" in message and "choose another --out" in message
