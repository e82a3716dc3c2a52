"""Calibration on rendered boards of both sensors, whose truth is Tables 4.2 to 4.5 of the thesis."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.bag import BagWriter, make_message
from rgbd_dic_acquisition.calibration import Calibration, load_calibration
from rgbd_dic_acquisition.errors import CalibrationError, ImageError, SettingsError
from rgbd_dic_acquisition.messages import CAMERA_INFO, IMAGE, camera_info_message, depth_message, image_message
from rgbd_dic_acquisition.simulator import board as simulated
from rgbd_dic_acquisition.simulator.sensors import CameraSettings, TofSettings, sensor_rig
from rgbd_dic_acquisition.simulator.speckle import Checkerboard
from rgbd_dic_processing.calibrating.board import Board, BoardSettings
from rgbd_dic_processing.calibrating.bundle import adjust
from rgbd_dic_processing.calibrating.calibrate import Calibrated, calibrate
from rgbd_dic_processing.calibrating.depth_bias import depth_bias
from rgbd_dic_processing.calibrating.detection import find_board
from rgbd_dic_processing.calibrating.model import LENS, Model
from rgbd_dic_processing.calibrating.settings import CalibratingSettings
from rgbd_dic_processing.calibrating.sources import Folders, Shot
from rgbd_dic_processing.cli import main
from scipy.spatial.transform import Rotation

TRUE = sensor_rig(CameraSettings(width_px=1440, height_px=1080), TofSettings(width_px=640, height_px=480))
BOARD = Board(BoardSettings())
BIAS_M = 0.004
COUNT = 10
CAMERA_FRAME, TOF_FRAME = "camera_optical_frame", "tof_optical_frame"


class Shots(list):
    """Shots in memory."""

    def __init__(self, shots):
        super().__init__(shots)
        self.notes: list[str] = []


def true_pixels(calibration: Calibration, sensor: str, T_camera_board) -> np.ndarray:
    """Where the corners of BOARD are, exactly."""
    points = BOARD.corners_m @ T_camera_board.R.T + T_camera_board.t
    if sensor == "tof":
        points = (points - calibration.t_camera_tof) @ calibration.R_camera_tof
    camera = getattr(calibration, sensor)
    return camera.distort(camera.project(points))


@pytest.fixture(scope="module")
def poses():
    size = simulated.BoardRig(TRUE, Checkerboard(9, 12, 0.03))
    return simulated.board_poses(TRUE.camera, (size.width_m, size.height_m), COUNT, np.random.default_rng(3))


@pytest.fixture(scope="module")
def frames(poses):
    """Boards of 9 x 12 squares before both sensors at full size, depth 4 mm too long with 5 mm of noise (Table 4.3)."""
    rig = simulated.BoardRig(TRUE, Checkerboard(9, 12, 0.03), simulated.BoardSettings(range_bias_m=BIAS_M))
    random = np.random.default_rng(4)
    return [rig.expose(pose, random) for pose in poses]


@pytest.fixture(scope="module")
def folders(frames, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("boards")
    for index, frame in enumerate(frames):
        depth_mm = np.nan_to_num(np.rint(1e3 * frame.depth_m)).astype(np.uint16)
        for name, image in (("camera", frame.camera), ("tof", frame.tof), ("depth", depth_mm)):
            (path / name).mkdir(exist_ok=True)
            cv2.imwrite(str(path / name / f"board{index}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    return path


@pytest.fixture(scope="module")
def result(folders) -> Calibrated:
    source = Folders(folders / "camera", folders / "tof", folders / "depth")
    return calibrate(source, BOARD, CalibratingSettings())


def shots(frames) -> Shots:
    return Shots(
        Shot(f"board{i}", frame.camera, frame.tof, frame.depth_m.astype(np.float32)) for i, frame in enumerate(frames)
    )


def in_sigmas(result: Calibrated) -> dict[str, float]:
    """Error of every estimate over its stated standard uncertainty."""
    estimate, found = result.estimate, result.estimate.calibration
    turn = Rotation.from_matrix(found.R_camera_tof @ TRUE.R_camera_tof.T).as_rotvec()
    shift = found.t_camera_tof - TRUE.t_camera_tof
    errors = {
        f"{sensor}.{name}": getattr(getattr(found, sensor), name) - getattr(getattr(TRUE, sensor), name)
        for sensor in ("camera", "tof")
        for name in LENS
    }
    names = ("about_x", "about_y", "about_z", "x", "y", "z")
    errors |= {f"T_camera_tof.{name}": error for name, error in zip(names, (*turn, *shift), strict=True)}
    return {name: errors[name] / estimate.sigma(name) for name in estimate.names}


def test_every_estimate_is_within_three_of_its_sigmas(result: Calibrated) -> None:
    pulls = in_sigmas(result)
    assert len(pulls) == 12
    assert max(abs(pull) for pull in pulls.values()) < 3, pulls
    assert result.bias is not None
    assert abs(result.bias.bias_m - BIAS_M) < 3 * result.bias.u_bias_m
    assert result.bias.noise_m == pytest.approx(0.005, rel=0.05)


def test_the_sigmas_are_small(result: Calibrated) -> None:
    """So that the test above means something: focal lengths to a part in a thousand, and with them, at 1.6 m, places to
    a millimetre."""
    estimate = result.estimate
    assert estimate.sigma("camera.fx") < 1.5 and estimate.sigma("tof.fx") < 0.5
    assert max(estimate.sigma(f"T_camera_tof.{axis}") for axis in "xyz") < 1e-3
    assert max(estimate.sigma(f"T_camera_tof.about_{axis}") for axis in "xyz") < 3e-4
    assert result.bias is not None and result.bias.u_bias_m < 1e-3


def test_free_principal_point(result: Calibrated) -> None:
    models = {"camera": Model(1440, 1080, True, True), "tof": Model(640, 480, True, False)}
    pulls = in_sigmas(replace(result, estimate=adjust(result.views, BOARD, models)))
    assert {"camera.cx", "tof.cy"} <= set(pulls)
    assert max(abs(pull) for pull in pulls.values()) < 3, pulls


def test_corners_are_unbiased(result: Calibrated, poses) -> None:
    """The mean error of all corners of a sensor is below 0.01 px, which no shift by half a pixel would survive."""
    for sensor, noise_px in (("camera", 0.05), ("tof", 0.12)):
        errors = np.concatenate(
            [
                view.of(sensor).corners_px - true_pixels(TRUE, sensor, pose)[view.of(sensor).ids]
                for view, pose in zip(result.views, poses, strict=True)
            ]
        )
        assert np.all(np.abs(errors.mean(axis=0)) < 0.01)
        assert np.all(errors.std(axis=0) < noise_px)


def test_a_board_upside_down_is_the_same_board(frames) -> None:
    upright, turned = find_board(frames[0].camera, BOARD), find_board(frames[0].camera[::-1, ::-1].copy(), BOARD)
    back = np.array([TRUE.camera.width, TRUE.camera.height]) - 1 - turned.corners_px
    np.testing.assert_allclose(back[np.argsort(turned.ids)], upright.corners_px[np.argsort(upright.ids)], atol=0.02)


@pytest.mark.parametrize(
    "rows, cols, said",
    [
        (8, 11, "are these the squares or the inner corners"),
        (6, 8, "but one of 8 x 11 inner corners (9 x 12 squares): give the size"),
        (14, 15, "only 8 x 11 inner corners"),
    ],
)
def test_wrong_board_size(frames, rows: int, cols: int, said: str) -> None:
    """Also smaller than the true one, of which a part is seen everywhere."""
    board = Board(BoardSettings(rows=rows, cols=cols))
    with pytest.raises(CalibrationError) as refusal:
        calibrate(Shots([Shot("one", tof=frames[1].tof)]), board, CalibratingSettings())
    assert said in str(refusal.value)
    assert f"looked for: checkerboard of {rows} x {cols} squares" in str(refusal.value)


def test_a_board_that_looks_the_same_when_turned_is_refused() -> None:
    with pytest.raises(SettingsError, match="looks the same"):
        Board(BoardSettings(rows=9, cols=9))


def test_wrong_size_of_squares_contradicts_the_depth(result: Calibrated) -> None:
    smaller = Board(BoardSettings(square_m=0.025))
    estimate = adjust(result.views, smaller, result.estimate.layout.models)
    with pytest.raises(CalibrationError, match=r"squares are of 25 mm: are they of 30\.\d mm"):
        depth_bias(result.views, smaller, estimate, scale_error=0.03)


def test_swapped_sensors(frames, folders) -> None:
    with pytest.raises(CalibrationError, match="the two are swapped"):
        calibrate(Shots([Shot("one", frames[0].tof, frames[0].camera)]), BOARD, CalibratingSettings())
    source = Folders(folders / "tof", folders / "camera", folders / "depth")
    with pytest.raises(ImageError, match="camera images given as ToF"):
        calibrate(source, BOARD, CalibratingSettings())


def test_what_cannot_be_used_is_skipped_with_its_reason(frames, result: Calibrated) -> None:
    """One board blurred, one cut off, one image of another size, one twice, and two ToF images interchanged."""
    bad = list(shots(frames))
    bad[0] = replace(bad[0], camera=cv2.blur(bad[0].camera, (25, 1)))
    beyond = int(find_board(bad[1].camera, BOARD).corners_px[:, 0].mean())
    bad[1] = replace(bad[1], camera=np.pad(bad[1].camera[:, beyond:], ((0, 0), (0, beyond)), constant_values=90))
    bad[2] = replace(bad[2], camera=cv2.resize(bad[2].camera, (1080, 810), interpolation=cv2.INTER_AREA))
    bad[3], bad[8] = (replace(bad[i], tof=bad[j].tof, depth_m=bad[j].depth_m) for i, j in ((3, 8), (8, 3)))
    bad.append(replace(bad[6], name="again"))
    settings = CalibratingSettings(least_boards=6, least_tilt_rad=0.05, covered=0.1)
    got = calibrate(Shots(bad), BOARD, settings)
    reasons = {(skipped.name, skipped.sensor): skipped.reason for skipped in got.skipped}
    assert "blurred" in reasons["board0", "camera"]
    assert "it is cut off by the edge of the image" in reasons["board1", "camera"]
    assert "1080 x 810 pixels" in reasons["board2", "camera"]
    assert "where it was in board6" in reasons["again", "camera"]
    assert all("they are not of one moment" in reasons[f"board{i}", "tof"] for i in (3, 8))
    assert max(abs(pull) for pull in in_sigmas(got).values()) < 3


def test_charuco_whole_and_cut_off() -> None:
    """A ChArUco board is found in part too; its corners are good to a tenth of a pixel, each with the right number."""
    size = sensor_rig(CameraSettings(width_px=720, height_px=540), TofSettings(width_px=320, height_px=240))
    rig = simulated.BoardRig(size, simulated.CharucoPattern(9, 12, 0.03))
    (pose,) = simulated.board_poses(size.camera, (0.44, 0.35), 1, np.random.default_rng(1), (1.0, 1.1))
    board = Board(BoardSettings(kind="charuco"))
    image = rig.expose(pose, np.random.default_rng(2)).camera
    true = true_pixels(size, "camera", pose)
    whole, part = find_board(image, board), find_board(image[:, : int(true[:, 0].mean())].copy(), board)
    assert len(whole.ids) > 80 and 30 < len(part.ids) < 60
    for found in (whole, part):
        assert np.sqrt(np.mean((found.corners_px - true[found.ids]) ** 2)) < 0.1
    with pytest.raises(ImageError, match="another board or dictionary"):
        find_board(image, Board(BoardSettings(kind="charuco", dictionary="DICT_6X6_250")))


@pytest.fixture
def bag(frames, tmp_path) -> Path:
    """The boards as a recording: the ToF frame between two camera images. At board 5 the rig still moves."""
    path = tmp_path / "recording"
    with BagWriter(path) as bag:
        topics = {"/camera/image_raw": IMAGE, "/tof/intensity/image_raw": IMAGE, "/tof/depth/image_raw": IMAGE}
        for topic, kind in {
            **topics,
            "/camera/camera_info": CAMERA_INFO,
            "/tof/depth/camera_info": CAMERA_INFO,
        }.items():
            bag.add_topic(topic, kind)
        for index, frame in enumerate(frames):
            at = 10**9 * (index + 1)
            moved = np.roll(frame.camera, 5 * (index == 5), axis=1)
            for offset_ns, image in ((-6_000_000, frame.camera), (10_000_000, moved)):
                message = image_message(make_message, at + offset_ns, CAMERA_FRAME, image, "mono8")
                bag.write_message("/camera/image_raw", at + offset_ns, message)
            bright = image_message(make_message, at, TOF_FRAME, frame.tof.astype(np.uint16) * 20, "mono16")
            bag.write_message("/tof/intensity/image_raw", at, bright)
            bag.write_message("/tof/depth/image_raw", at, depth_message(make_message, at, TOF_FRAME, frame.depth_m))
            for topic, camera, frame_id in (
                ("/camera/camera_info", TRUE.camera, CAMERA_FRAME),
                ("/tof/depth/camera_info", TRUE.tof, TOF_FRAME),
            ):
                bag.write_message(topic, at, camera_info_message(make_message, at, frame_id, camera))
    return path


def test_bag_to_page(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["calibrate", str(bag), "--every", "0.5", "--out", str(out)]) == 0
    found = load_calibration(out / "calibration.yaml")
    assert found.camera.fx == pytest.approx(TRUE.camera.fx, abs=3)
    np.testing.assert_allclose(found.t_camera_tof, TRUE.t_camera_tof, atol=1e-3)
    page = (out / "calibration.html").read_text()
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert page.count("data:image/jpeg") == 2 * COUNT - 1
    assert "between this frame and the camera&#39;s image: hold it still" in page
    assert "camera.fx" in capsys.readouterr().out


def test_refusal_on_the_command_line(folders, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for index in range(3):
        (few / f"board{index}.png").symlink_to(folders / "camera" / f"board{index}.png")
    assert main(["calibrate", "--camera", str(few), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "3 usable boards in 3 images, at least 8 different ones are needed" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_uncertainties_over_many_rendered_sets() -> None:
    """Eight sets of 15 boards: 96 errors, some 50 of them independent, so that their RMS is known to 10 %."""
    rig = simulated.BoardRig(TRUE, Checkerboard(9, 12, 0.03))
    pulls = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        frames = [
            rig.expose(pose, random)
            for pose in simulated.board_poses(TRUE.camera, (rig.width_m, rig.height_m), 15, random)
        ]
        pulls += list(in_sigmas(calibrate(shots(frames), BOARD, CalibratingSettings())).values())
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.2
    assert np.max(np.abs(pulls)) < 3.5
