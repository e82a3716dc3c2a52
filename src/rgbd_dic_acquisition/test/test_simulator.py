"""The simulator against analytic truth and independent measurements."""

import csv
import hashlib
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Camera, load_calibration
from rgbd_dic_acquisition.errors import BagError, RegionsError, SettingsError
from rgbd_dic_acquisition.simulator import (
    Flight,
    FlightSettings,
    SimulatedCamera,
    SimulatedTof,
    sample_flight_settings,
    simulate_flight,
)
from rgbd_dic_acquisition.simulator.ground_truth import project, scene_regions
from rgbd_dic_acquisition.simulator.live import scene_time_s
from rgbd_dic_acquisition.simulator.motion import (
    CrackState,
    HandheldMotion,
    MotionSettings,
    Pose,
    crack_state,
    thesis_pose,
)
from rgbd_dic_acquisition.simulator.scene import GAP, PAINTED, WALL, CrackedPanel, PanelSettings
from rgbd_dic_acquisition.simulator.sensors import CameraModel, CameraSettings, TofSettings, sensor_rig
from rgbd_dic_acquisition.simulator.speckle import Checkerboard, SpeckleSettings, make_pattern
from rgbd_dic_acquisition.simulator.timing import ticks
from scipy.spatial.transform import Rotation

from rgbd_dic_acquisition import messages

SAMPLE = Path(__file__).parents[3] / "bags" / "sample"
LENS = Camera(240, 180, 410.0, 411.0, 119.5, 89.5, 0.05, 0.3)  # ten times the real lens's distortion
TILTED = Pose(Rotation.from_euler("yxz", [20, -12, 8], degrees=True).as_matrix(), np.array([0.03, -0.02, 1.1]))
NO_NOISE = CameraSettings(read_noise=0.0, shot_noise=0.0)


def small_settings(**changes):
    s = sample_flight_settings()
    small = replace(s, camera=replace(s.camera, width_px=160, height_px=120, supersampling=2), duration_s=0.3)
    return replace(small, tof=replace(s.tof, width_px=80, height_px=60), **changes)


class Blob:
    """One Gaussian spot, 8 mm of standard deviation, somewhere on the panel."""

    def __init__(self, centre_m):
        self.centre_m = centre_m

    def grey(self, x_m, y_m):
        squared = (x_m - self.centre_m[0]) ** 2 + (y_m - self.centre_m[1]) ** 2
        return 100 + 100 * np.exp(-0.5 * squared / 0.008**2)


@pytest.mark.parametrize("seed", [1, 2])
def test_blob_texture_interpolates_to_a_hundredth_of_a_grey_level(seed):
    rng = np.random.default_rng(seed)
    pattern = make_pattern(SpeckleSettings(), 0.2, 0.15, rng)
    x, y = rng.uniform(-0.1, 0.1, 3000), rng.uniform(-0.075, 0.075, 3000)
    grey = pattern.grey(x, y)
    np.testing.assert_allclose(grey, pattern.grey_exact(x, y), atol=0.01)
    assert grey.std() > 25  # contrast enough for DIC


def test_disks_are_sharp_of_the_right_size_and_cover_the_panel():
    settings = SpeckleSettings(kind="disks", size_m=0.05, spacing=1.3, variability=0.49)
    pattern = make_pattern(settings, 2.0, 2.0, np.random.default_rng(3))
    x, y = np.meshgrid(np.linspace(-1, 1, 301), np.linspace(-1, 1, 301))
    grey = pattern.grey(x, y)
    assert set(np.unique(grey)) == {settings.dark, settings.light}
    nearest = np.min(
        [np.hypot(x - cx, y - cy) for cx, cy in pattern._centres.reshape(-1, 2)], axis=0
    )  # every disk, not only the neighbours
    np.testing.assert_array_equal(grey == settings.dark, nearest <= 0.025)


def forward_centroid(pattern, displacement, pose, lens):
    """Centroid [px] of a spot: its points projected, each with the weight of the area that it covers."""
    around = np.linspace(-0.048, 0.048, 193)
    grid = np.stack(np.meshgrid(around, around), axis=-1) + pattern.centre_m
    points = np.concatenate([grid, np.zeros((*grid.shape[:2], 1))], axis=-1).reshape(-1, 3) + displacement
    pixels = lens.distort(lens.project(points @ pose.R.T + pose.t)).reshape(grid.shape)
    down, across = np.gradient(pixels, axis=(0, 1))
    area = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
    weight = area * (pattern.grey(grid[..., 0], grid[..., 1]) - 100)
    return np.sum(pixels * weight[..., None], axis=(0, 1)) / weight.sum()


@pytest.mark.parametrize("centre_m", [(-0.2, -0.12), (-0.1, 0.1), (0.12, 0.11), (0.2, -0.1)])
@pytest.mark.parametrize("crack", [CrackState(), CrackState(0.010, -0.004, 0.006)])
def test_blob_is_where_the_lens_projects_it(centre_m, crack):
    """Centroid in the image against forward projection; 1/500 px is what the window of 4 sigma cuts off."""
    scene = CrackedPanel(PanelSettings(), Blob(centre_m))
    image = CameraModel(LENS, NO_NOISE).radiance(scene, TILTED, crack)
    displacement = scene.displacement(crack) if centre_m[0] > 0 else np.zeros(3)
    expected = forward_centroid(Blob(centre_m), displacement, TILTED, LENS)
    col, row = np.rint(expected).astype(int)
    window = np.s_[row - 12 : row + 13, col - 12 : col + 13]
    weight = image[window] - 100
    rows, cols = np.mgrid[window]
    centroid = np.array([np.sum(cols * weight), np.sum(rows * weight)]) / weight.sum()
    np.testing.assert_allclose(centroid, expected, atol=0.002)


def test_supersampling_integrates_an_edge():
    """The panel's edge between columns: a pixel that it halves has half of the light, to 1/16 of the step."""
    camera = Camera(40, 30, 400.0, 400.0, 19.5, 14.5)
    scene = CrackedPanel(PanelSettings(width_m=0.05, height_m=1.0, gap_m=0.0), Blob((9.0, 9.0)))
    settings = replace(NO_NOISE, supersampling=16)
    edge_px = np.array([19.5 - 0.025 * 400, 19.5 + 0.025 * 400])  # at pixel centres 9.5 and 29.5
    image = CameraModel(camera, settings).radiance(scene, Pose(np.eye(3), np.array([0, 0, 1.0])), CrackState())
    shifted = Pose(np.eye(3), np.array([0.3 / 400, 0, 1.0]))  # 0.3 px to the right
    moved = CameraModel(camera, settings).radiance(scene, shifted, CrackState())
    left = int(edge_px[0])
    np.testing.assert_allclose(image[15, left - 1 : left + 3], [95, 95, 100, 100], atol=0.01)
    np.testing.assert_allclose(moved[15, left + 1], 0.3 * 95 + 0.7 * 100, atol=5 / 16)


@pytest.mark.parametrize("opening_m", [0.0, 0.01])
def test_only_what_is_not_uniform_is_supersampled(opening_m):
    """A pattern of flat parts gives the same image whether it says so or not."""
    pattern = make_pattern(SpeckleSettings(kind="disks", size_m=0.01), 0.3, 0.2, np.random.default_rng(3))

    class Unknown:
        grey = staticmethod(pattern.grey)

    camera = Camera(160, 120, 200.0, 210.0, 80.3, 60.1, -0.1, 0.02)
    model = CameraModel(camera, replace(NO_NOISE, supersampling=5))
    pose = thesis_pose((12.0, -9.0, 20.0), (350.0, 110.0, -80.0))
    panel = PanelSettings(width_m=0.3, height_m=0.2, gap_m=0.002)
    quick, full = (
        model.radiance(CrackedPanel(panel, p), pose, CrackState(opening_m, 0.003)) for p in (pattern, Unknown())
    )
    assert len(np.unique(full)) > 20
    np.testing.assert_allclose(quick, full, atol=1e-9)


def test_checkerboard_changes_at_its_corners():
    board = Checkerboard(15, 20, 0.05)
    assert board.corners_m.shape == (14 * 19, 2)
    np.testing.assert_allclose(board.corners_m[[0, -1]], [[-0.45, -0.325], [0.45, 0.325]], atol=1e-12)
    x, y = board.corners_m.T
    quadrants = np.array([board.grey(x + dx, y + dy) for dx in (-0.01, 0.01) for dy in (-0.01, 0.01)])
    assert np.all(quadrants[0] == quadrants[3]) and np.all(quadrants[1] == quadrants[2])
    assert np.all(quadrants[0] != quadrants[1])
    assert board.uniform(x + 0.02, y + 0.02, np.full(len(x), 0.015)).all()
    assert not board.uniform(x + 0.02, y + 0.02, np.full(len(x), 0.025)).any()


def test_thesis_angles():
    """The camera starts squarely in front; yaw is left-handed about the axis up: the panel moves left in the image."""
    start = thesis_pose((0, 0, 0), (0, 0, 0))
    np.testing.assert_allclose(start.R, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(start.t, [0, 0, 1])
    np.testing.assert_allclose(thesis_pose((0, 0, 0), (100, 20, 30)).t, [0.02, 0.03, 0.9], atol=1e-15)
    for angles, moved in (((10, 0, 0), (-1, 0)), ((0, 10, 0), (0, 1))):
        turned = thesis_pose(angles, (0, 0, 0))
        np.testing.assert_allclose(turned.t[:2], np.sin(np.deg2rad(10)) * np.array(moved), atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(thesis_pose((7, -5, 40), (1, 2, 3)).R), 1)


def test_rendering_does_not_depend_on_threads():
    scene = CrackedPanel(PanelSettings(), Blob((0.1, 0.0)))
    one, four = (CameraModel(LENS, NO_NOISE, workers).radiance(scene, TILTED, CrackState()) for workers in (1, 4))
    np.testing.assert_array_equal(one, four)


@pytest.fixture(scope="module")
def squarely_in_front():
    """At rest, image plane parallel to the panel, no distortion: one metre is f / distance pixels."""
    at_rest = MotionSettings(yaw_rad=0.0, pitch_rad=0.0, roll_rad=0.0, sway_m=0.0, sway_rad=0.0)
    flight = Flight(small_settings(motion=at_rest))
    lens = replace(sensor_rig(CameraSettings(), TofSettings()).camera, k1=0.0, k2=0.0)
    return flight, CameraModel(lens, NO_NOISE)


RIGHT_PART, LEFT_PART = np.s_[80:280, 260:400], np.s_[80:280, 60:200]


def test_shift_by_whole_pixels_gives_the_same_pixels(squarely_in_front):
    flight, model = squarely_in_front
    pixel_m = flight.settings.motion.distance_m / np.array([model.camera.fx, model.camera.fy])
    crack = CrackState(2 * pixel_m[0], -3 * pixel_m[1])
    before, after = (model.radiance(flight.scene, flight.pose(0.0), state) for state in (CrackState(), crack))
    np.testing.assert_allclose(np.roll(after, (3, -2), axis=(0, 1))[RIGHT_PART], before[RIGHT_PART], atol=1e-6)
    np.testing.assert_array_equal(after[LEFT_PART], before[LEFT_PART])


def phase_shift(before, after):
    """Shift x, y [px] between two images from the slope of the phase of their cross-spectrum."""
    rows, cols = before.shape
    window = np.hanning(rows)[:, None] * np.hanning(cols)
    first, second = (np.fft.fft2((image - image.mean()) * window) for image in (before, after))
    cross, (fy, fx) = (
        first * np.conj(second),
        np.meshgrid(np.fft.fftfreq(rows), np.fft.fftfreq(cols), indexing="ij"),
    )
    keep = (np.hypot(fx, fy) < 0.3) & (np.abs(cross) > 0.05 * np.abs(cross).max())
    slope, weight, shift = (
        2 * np.pi * np.stack([fx[keep], fy[keep]], axis=1),
        np.abs(cross[keep]),
        np.zeros(2),
    )
    for _ in range(4):
        phase = np.angle(cross[keep] * np.exp(-1j * slope @ shift))
        shift += np.linalg.solve(slope.T @ (weight[:, None] * slope), slope.T @ (weight * phase))
    return shift


@pytest.mark.parametrize(("opening_m", "sliding_m"), [(1e-3, 0.0), (1e-3, 0.3e-3), (-0.5e-3, 2e-3)])
def test_displacement_measured_by_another_method(squarely_in_front, opening_m, sliding_m):
    """Phase correlation of the right part; what comes in at its window's edge leaves some 0.002 px."""
    flight, model = squarely_in_front
    before, after = (
        model.radiance(flight.scene, flight.pose(0.0), state)
        for state in (CrackState(), CrackState(opening_m, sliding_m))
    )
    focal_px = np.array([model.camera.fx, model.camera.fy])
    expected = np.array([opening_m, sliding_m]) * focal_px / flight.settings.motion.distance_m
    np.testing.assert_allclose(phase_shift(before[RIGHT_PART], after[RIGHT_PART]), expected, atol=0.003)


def test_crack_at_an_angle_moves_along_its_normal_and_tangent():
    scene = CrackedPanel(PanelSettings(crack_angle_rad=0.3), Blob((0, 0)))
    moved = scene.displacement(CrackState(2e-3, 1e-3, 3e-3))
    np.testing.assert_allclose([moved @ scene.normal, moved @ scene.tangent, moved[2]], [2e-3, 1e-3, 3e-3])
    np.testing.assert_allclose(np.cross(scene.normal, scene.tangent), [0, 0, 1], atol=1e-15)


def test_gap_shows_what_has_opened():
    """In the panel's middle the dark gap is as wide as at the start plus what has opened, to one ray."""
    scene = CrackedPanel(PanelSettings(gap_m=0.002), Blob((0, 0)))
    rays = np.stack([np.linspace(-0.01, 0.01, 20001), np.zeros(20001), np.ones(20001)], axis=-1)
    pose = Pose(np.eye(3), np.array([0, 0, 1.0]))
    for opening in (0.0, 0.003):
        gap = scene.look(rays, pose, CrackState(opening)).surface == GAP
        assert gap.sum() * 1e-6 == pytest.approx(0.002 + opening, abs=2e-6)
        assert np.ptp(np.flatnonzero(gap)) == gap.sum() - 1  # in one piece


def test_tof_depth_lies_on_the_planes():
    """Without noise, every depth lies on the panel, or 0.6 m behind it, through intrinsics and extrinsics."""
    s = small_settings()
    flight = Flight(replace(s, tof=replace(s.tof, range_noise_m=0.0, dropouts=0.0)))
    frame, pose, calibration = flight.depth(0.1, 0), flight.pose(0.1), flight.calibration
    rows, cols = np.mgrid[: calibration.tof.height, : calibration.tof.width]
    pixels = np.stack([cols.ravel(), rows.ravel()], axis=-1).astype(float)
    in_tof = calibration.tof.rays(pixels) * frame.depth_m.reshape(-1, 1)
    in_camera = in_tof @ calibration.R_camera_tof.T + calibration.t_camera_tof
    in_panel = (in_camera - pose.t) @ pose.R
    on_panel = (np.abs(in_panel[:, 2]) < 1e-9) & (np.abs(in_panel[:, 0]) < 0.29) & (np.abs(in_panel[:, 1]) < 0.21)
    on_wall = np.abs(in_panel[:, 2] - 0.6) < 1e-9
    assert np.all(on_panel | on_wall)
    assert on_panel.sum() > 500 and on_wall.sum() > 500


def test_tof_noise_is_what_the_settings_say():
    s = small_settings()
    exact = Flight(replace(s, tof=replace(s.tof, range_noise_m=0.0, dropouts=0.0))).depth(0.1, 0)
    flight = Flight(replace(s, tof=replace(s.tof, dropouts=0.05)))
    noisy = np.array([flight.depth(0.1, index).depth_m for index in range(50)])
    along_ray = np.linalg.norm(flight.tof_model._rays, axis=-1)
    error = (noisy - exact.depth_m) * along_ray
    assert np.nanstd(error) == pytest.approx(0.005, rel=0.01)  # of 240 000 values: 0.15 %
    assert np.nanmean(error) == pytest.approx(0.0, abs=5e-5)
    assert np.isnan(noisy).mean() == pytest.approx(0.05, abs=0.002)
    assert not np.array_equal(noisy[0], noisy[1])


def test_camera_noise_is_what_the_settings_say():
    s = small_settings(camera=CameraSettings(160, 120, 2, read_noise=0.8, shot_noise=0.003))
    flight = Flight(s)
    light = flight.camera_model.radiance(flight.scene, flight.pose(0.0), flight.crack(0.0))
    images = np.array([flight.image(0.0, index) for index in range(100)], float)
    expected = np.sqrt(0.8**2 + 0.003 * light + 1 / 12)  # with the rounding to 8 bits
    assert (images.std(axis=0) / expected).mean() == pytest.approx(1.0, abs=0.02)
    assert (images.mean(axis=0) - light).mean() == pytest.approx(0.0, abs=0.01)


def test_motion_has_the_amplitude_and_the_band_of_the_settings():
    settings = MotionSettings(sway_m=0.02, sway_rad=0.03)
    motion = HandheldMotion(settings, np.random.default_rng(5))
    rate, seconds = 50.0, 400.0
    poses = [motion.pose(t) for t in np.arange(0, seconds, 1 / rate)]
    average = HandheldMotion(replace(settings, sway_m=0.0, sway_rad=0.0), np.random.default_rng(5)).pose(0.0)
    turn = Rotation.from_matrix([pose.R @ average.R.T for pose in poses])
    shift = np.array([pose.t for pose in poses]) - turn.apply(average.t)
    for values, rms in ((shift, 0.02), (turn.as_rotvec(), 0.03)):
        np.testing.assert_allclose(values.std(axis=0), rms, rtol=0.1)
        power = np.abs(np.fft.rfft(values * np.hanning(len(values))[:, None], axis=0)) ** 2
        frequency = np.fft.rfftfreq(len(values), 1 / rate)
        outside = (frequency < 0.28) | (frequency > 3.02)
        assert power[outside].sum() < 1e-3 * power.sum()


def test_crack_starts_at_exactly_zero_and_is_not_monotonic():
    settings = sample_flight_settings().crack
    times = np.arange(0, 2, 1 / 60)
    states = [crack_state(settings, t, 2.0) for t in times]
    opening = np.array([state.opening_m for state in states])
    assert np.all(opening[times <= settings.still_s] == 0.0)
    assert crack_state(settings, 2.0, 2.0) == CrackState(1e-3, 0.3e-3, 0.2e-3)
    assert np.diff(opening).min() < -1e-5 and np.abs(np.diff(opening)).max() < 1e-4


def test_clocks_run_free():
    def stream(skew_ppm, seed):
        rng = np.random.default_rng(seed)
        return ticks(60000, 60.0, rng, skew_ppm=skew_ppm, jitter_s=1e-3, latency_s=0.01)

    for skew_ppm in (40.0, -65.0):
        got = stream(skew_ppm, 1)
        period_ns = np.polyfit(np.arange(60000), got.exposed_ns, 1)[0]
        assert period_ns * 60e-9 - 1 == pytest.approx(skew_ppm * 1e-6, abs=1e-8)
        assert np.all(np.diff(got.exposed_ns) > 0) and np.all(np.diff(got.arrived_ns) > 0)
        assert np.all(got.arrived_ns > got.exposed_ns)


def digest(folder):
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def flight_bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "small"
    seen = []
    summary = simulate_flight(small_settings(), path, lambda done, total: seen.append((done, total)))
    assert seen[-1] == (54, 54) and len(seen) == 54  # 18 images, 6 ToF frames, 30 attitudes
    return path, summary


def test_bag_holds_what_was_announced_and_both_libraries_read_it(flight_bag):
    path, summary = flight_bag
    assert summary.counts == {
        "/camera/image_raw": 18,
        "/camera/camera_info": 18,
        "/tof/depth/image_raw": 6,
        "/tof/depth/camera_info": 6,
        "/tof/intensity/image_raw": 6,
        "/tof/confidence/image_raw": 6,
        "/imu/data": 30,
        "/tf_static": 1,
        "/crack_opening_truth": 18,
    }
    with BagReader(path) as bag:
        assert {name: info.count for name, info in bag.topics.items()} == summary.counts
        assert sum(1 for _ in bag.messages()) == sum(summary.counts.values())
    with (path / "small_0.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == sum(summary.counts.values())


def test_stamps_grow_logs_come_later_and_the_clocks_differ(flight_bag):
    stamps, logs = {}, []
    with BagReader(flight_bag[0]) as bag:
        for topic, log_ns, msg in bag.messages():
            logs.append(log_ns)
            if topic != "/tf_static":
                stamps.setdefault(topic, []).append(messages.stamp_to_ns(msg.header.stamp))
                assert log_ns > stamps[topic][-1]
    assert logs == sorted(logs)
    assert all(np.all(np.diff(values) > 0) for values in stamps.values())
    assert stamps["/camera/image_raw"] == stamps["/camera/camera_info"] == stamps["/crack_opening_truth"]
    assert stamps["/tof/depth/image_raw"] == stamps["/tof/confidence/image_raw"]
    images, frames = np.array(stamps["/camera/image_raw"]), np.array(stamps["/tof/depth/image_raw"])
    assert len(images) == 3 * len(frames)
    nearest = np.abs(images[:, None] - frames).min(axis=1)
    assert nearest.min() > 0 and nearest.max() < 30e6  # never the same moment, never more than a frame away


def test_truth_calibration_and_infos_agree(flight_bag):
    path, _ = flight_bag
    flight, calibration = Flight(small_settings()), load_calibration(path / "calibration.yaml")
    np.testing.assert_array_equal(calibration.t_camera_tof, flight.calibration.t_camera_tof)
    np.testing.assert_allclose(calibration.R_camera_tof, flight.calibration.R_camera_tof, atol=1e-15)
    rows = list(csv.DictReader((path / "truth.csv").open()))
    with BagReader(path) as bag:
        truth = [msg for _, _, msg in bag.messages(["/crack_opening_truth"])]
        (static,) = [msg for _, _, msg in bag.messages(["/tf_static"])]
        infos = [(topic, msg) for topic, _, msg in bag.messages(["/camera/camera_info", "/tof/depth/camera_info"])]
    for topic, info in infos:
        expected = calibration.camera if topic.startswith("/camera") else calibration.tof
        assert Camera.from_camera_info(info) == expected
    shift = static.transforms[0].transform.translation
    np.testing.assert_allclose([shift.x, shift.y, shift.z], calibration.t_camera_tof)
    assert len(rows) == len(truth) == 18
    for row, msg in zip(rows, truth, strict=True):
        assert int(row["stamp_ns"]) == messages.stamp_to_ns(msg.header.stamp)
        for name in ("opening", "sliding", "out_of_plane"):
            assert float(row[f"{name}_mm"]) == pytest.approx(1e3 * getattr(msg, name), abs=1e-9)
        pose = flight.pose((int(row["stamp_ns"]) - 1_750_000_000 * 10**9) * 1e-9)
        quaternion = [float(row[f"panel_q{axis}"]) for axis in "xyzw"]
        np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), pose.R, atol=1e-11)
        np.testing.assert_allclose([float(row[f"panel_{axis}_mm"]) for axis in "xyz"], 1e3 * pose.t, atol=1e-8)
    assert float(rows[0]["opening_mm"]) == 0.0 and float(rows[-1]["opening_mm"]) > 0.5


def test_attitude_turns_the_panel_upright(flight_bag):
    """Whatever the camera does, the wall's normal is north and the panel's y is down, to the IMU's noise."""
    flight = Flight(small_settings())
    with BagReader(flight_bag[0]) as bag:
        for _, _, msg in bag.messages(["/imu/data"]):
            q = msg.orientation
            R_world_body = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
            pose = flight.pose((messages.stamp_to_ns(msg.header.stamp) - 1_750_000_000 * 10**9) * 1e-9)
            into_wall, down = pose.R[:, 2], pose.R[:, 1]  # in the camera's optical frame
            to_body = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # forward z, left -x, up -y
            np.testing.assert_allclose(R_world_body @ to_body @ into_wall, [0, 1, 0], atol=0.012)  # 6 sigma
            np.testing.assert_allclose(R_world_body @ to_body @ down, [0, 0, -1], atol=0.012)


def test_same_settings_give_the_same_bytes_and_another_seed_does_not(flight_bag, tmp_path):
    path, _ = flight_bag
    simulate_flight(small_settings(), tmp_path / "small")
    assert digest(tmp_path / "small") == digest(path)
    simulate_flight(small_settings(seed=2), tmp_path / "other" / "small")
    assert digest(tmp_path / "other" / "small")["small_0.mcap"] != digest(path)["small_0.mcap"]


def test_regions_are_on_the_plates_they_belong_to():
    flight = Flight(small_settings(panel=PanelSettings(crack_angle_rad=0.2)))
    regions = scene_regions(flight, 0.0)
    lens, scene = flight.calibration.camera, flight.scene
    assert project(flight, np.zeros((1, 3)), 0.0)[0] == pytest.approx(regions["crack"]["point"], abs=0.01)
    fixed = np.array(regions["fixed"][0])
    sight = scene.look(lens.rays(lens.undistort(fixed)), flight.pose(0.0), CrackState(0.05))
    across = sight.x_m * scene.normal[0] + sight.y_m * scene.normal[1]
    assert np.all(sight.surface == PAINTED) and np.all(across < -0.02)
    panel = np.array(regions["panel"])
    outside = panel + 26 * np.sign(panel - panel.mean(axis=0))
    assert np.all(scene.look(lens.rays(lens.undistort(outside)), flight.pose(0.0), CrackState()).surface == WALL)
    direction = np.array(regions["crack"]["direction"])
    normal_px = np.array([direction[1], -direction[0]])
    assert normal_px[0] > 0 and np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-5)


def test_panel_that_does_not_fit_is_refused():
    with pytest.raises(RegionsError, match=r"panel of 2.0 x 0.42 m does not fit"):
        scene_regions(Flight(small_settings(panel=PanelSettings(width_m=2.0))), 0.0)


def test_existing_bag_is_not_overwritten(flight_bag):
    with pytest.raises(BagError, match="exists already"):
        simulate_flight(small_settings(), flight_bag[0])


def test_settings_from_yaml_and_their_limits():
    text = "{seed: 3, motion: {distance_m: 2}, speckle: {kind: disks}}"
    settings = FlightSettings.from_mapping(yaml.safe_load(text))
    assert (settings.seed, settings.motion.distance_m, settings.speckle.kind) == (3, 2, "disks")
    assert settings.camera == CameraSettings()
    with pytest.raises(SettingsError, match=r"MotionSettings.distance_m = -1.0 m is out of range"):
        FlightSettings.from_mapping({"motion": {"distance_m": -1.0}})
    with pytest.raises(SettingsError, match=r"settings.motion: unknown setting speed"):
        FlightSettings.from_mapping({"motion": {"speed": 1.0}})
    with pytest.raises(SettingsError, match="choose one of blobs, disks"):
        SpeckleSettings(kind="stripes")


def test_live_sources_show_the_moment_of_their_stamp():
    """Both sensors, at full rate: a frame shows the flight at the time of its stamp, and none comes twice."""
    settings = small_settings()
    settings = replace(settings, tof=replace(settings.tof, range_noise_m=0.0, dropouts=0.0))
    rendered = []
    with SimulatedCamera(settings, lambda done, total: rendered.append((done, total))) as camera:
        assert rendered[-1] == (19, 19)
        assert camera.camera == camera.flight.calibration.camera
        frames = [camera.read(1.0) for _ in range(40)]  # there and back once, and on
    with SimulatedTof(settings) as tof:
        depths = [tof.read(1.0) for _ in range(3)]
    assert abs(frames[-1].stamp_ns - time.time_ns()) < 5e9
    steps = np.diff([frame.stamp_ns for frame in frames])
    assert np.all(steps > 0) and np.median(steps) == pytest.approx(1e9 / 60, abs=2)
    for frame in frames[::5]:
        pose, crack = camera.truth(frame.stamp_ns)
        light = camera.flight.camera_model.radiance(camera.flight.scene, pose, crack)
        assert np.abs(frame.image - light).mean() < 1.2  # the noise alone; a frame earlier or later is above 4
    for frame in depths:
        time_s = scene_time_s(frame.stamp_ns, settings)
        np.testing.assert_allclose(frame.depth_m, tof.flight.depth(time_s, 0).depth_m, rtol=1e-6)
        assert frame.intensity.shape == frame.confidence.shape == frame.depth_m.shape


def test_live_source_returns_nothing_when_nothing_is_due():
    settings = small_settings()
    slow = replace(settings, timing=replace(settings.timing, tof_rate_hz=0.1))
    with SimulatedTof(slow) as tof:
        assert tof.read(0.0) is not None  # the last one, just now or up to ten seconds ago
        assert tof.read(0.0) is None
        started = time.monotonic()
        assert tof.read(0.05) is None
        assert time.monotonic() - started < 1.0


@pytest.mark.slow
def test_sample_bag_is_what_its_settings_make(tmp_path):
    """Message by message, because the compression may differ with the version of its library."""
    simulate_flight(sample_flight_settings(), tmp_path / "sample")
    for name in ("truth.csv", "regions.yaml"):
        assert (tmp_path / "sample" / name).read_text() == (SAMPLE / name).read_text()
    made, kept = (load_calibration(path / "calibration.yaml") for path in (tmp_path / "sample", SAMPLE))
    assert (made.camera, made.tof) == (kept.camera, kept.tof)
    assert np.array_equal(made.t_camera_tof, kept.t_camera_tof)
    np.testing.assert_allclose(made.R_camera_tof, kept.R_camera_tof, atol=1e-12)  # processors round differently
    with BagReader(SAMPLE) as kept, BagReader(tmp_path / "sample") as made:
        assert kept.topics == made.topics
        for old, new in zip(kept.raw_messages(), made.raw_messages(), strict=True):
            if old[0] in ("/tf_static", "/crack_opening_truth"):
                np.testing.assert_allclose(doubles(old[3]), doubles(new[3]), rtol=1e-9, atol=1e-12)
                old, new = old[:3], new[:3]
            assert old == new, "make it again: rgbd-dic simulate --preset sample --out bags/sample"


def doubles(data: bytes) -> np.ndarray:
    """Of a serialised message, among what else there is, which must then be the same."""
    return np.frombuffer(data, offset=4, count=(len(data) - 4) // 8)


def test_sample_bag_fits_into_git_and_keeps_the_panel_in_view():
    assert sum(file.stat().st_size for file in SAMPLE.iterdir()) <= 20e6
    flight = Flight(sample_flight_settings())
    panel, lens = flight.scene.settings, flight.calibration.camera
    corners = np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]) * [
        panel.width_m / 2,
        panel.height_m / 2,
        0,
    ]
    for time_s in np.arange(0, 2, 1 / 60):
        seen = project(flight, corners, time_s)
        assert np.all(seen > 5) and np.all(seen < [lens.width - 6, lens.height - 6])
