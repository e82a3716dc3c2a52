"""The laboratory's images, depth, clocks and files against its own truth."""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.errors import SettingsError
from rgbd_dic_acquisition.messages import stamp_to_ns
from rgbd_dic_acquisition.simulator.flight_bag import START_NS
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_acquisition.simulator.laboratory_bag import REFERENCE_FILE, simulate_laboratory
from rgbd_dic_acquisition.simulator.laboratory_pattern import PatternSettings, Texture
from rgbd_dic_acquisition.simulator.speckle import FWHM_SIGMAS, SpeckleSettings, spot_centres
from scipy.optimize import fsolve

LOADED_S = 1.3
SMALL = {"camera": {"scale": 0.25}, "tof": {"scale": 0.25}, "duration_s": 6.0}


def make(preset="laboratory", **groups):
    """A small laboratory with some settings changed."""
    merged = {k: {**SMALL.get(k, {}), **group} if isinstance(group, dict) else group for k, group in groups.items()}
    return Laboratory(laboratory_settings(preset, {**SMALL, **merged}))


@pytest.fixture(scope="module")
def plain():
    return make()


@pytest.fixture(scope="module")
def hard():
    return make("laboratory_hard")


def material_points(count=60):
    rng = np.random.default_rng(3)
    return rng.uniform(-0.59, 0.59, count), rng.uniform(-0.29, 0.29, count)


@pytest.mark.parametrize("field", ["beam", "plate", "rigid_half", "kirchhoff"])
def test_projection_and_its_inverse_agree(field):
    lab = make("laboratory_hard", deformation={"field": field})
    x, y = material_points()
    for time_s in (LOADED_S, 2.6):
        pixels = lab.project(x, y, time_s)
        np.testing.assert_allclose(lab.material(pixels, time_s), np.column_stack([x, y]), atol=1e-12)
    assert np.all(np.isnan(lab.material(np.array([[-300.0, 10.0]]), 0.5)))


def test_truth_starts_at_the_first_image_and_is_the_jump_at_the_crack(plain):
    x, y = material_points()
    assert np.all(plain.displacement(x, y, plain.reference_s) == 0)
    faces = [plain.displacement(np.zeros(3), np.array([-0.2, 0.0, 0.2]), LOADED_S, side) for side in (-1, 1)]
    np.testing.assert_allclose(faces[1] - faces[0], plain.jump(np.array([-0.2, 0.0, 0.2]), LOADED_S), atol=1e-18)
    zones, crack = plain.crack(LOADED_S), plain.jump(np.array(0.0), LOADED_S)
    assert zones.opening_m == pytest.approx(crack[0], abs=2e-5)  # the zones are beside the crack, on what bends
    assert crack[0] > 4e-4
    on_faces = np.array([[-1e-9, 0.0]]), np.array([[1e-9, 0.0]])
    assert plain.crack(LOADED_S, on_faces).opening_m == pytest.approx(crack[0], abs=1e-11)


def test_image_shows_the_material_that_is_there(hard):
    """Pixels of one moment against the pattern at material that a general solver finds through `project` alone."""
    lab, camera = hard, hard.calibration.camera
    image = lab.camera_model.instant(lab.moment(LOADED_S))
    around = lab.project(*material_points(40), LOADED_S)
    pixels = np.rint(around[np.abs(np.array(material_points(40)[0])) > 0.02]).astype(int)
    pixels = pixels[np.all((pixels > 0) & (pixels < [camera.width - 1, camera.height - 1]), axis=1)]
    assert len(pixels) > 25
    for pixel in pixels:
        start = lab.material(pixel[None].astype(float), LOADED_S)[0] + 1e-3 * np.sign(pixel[0] - 200)
        side = int(np.sign(lab.material(pixel[None].astype(float), LOADED_S)[0, 0]))
        found = fsolve(lambda at, p=pixel, s=side: lab.project(*at, LOADED_S, s) - p, start, xtol=1e-13)
        lamps = 1 + lab.settings.camera.lamp_gradient * 2 / lab.settings.panel.width_m * found[0]
        expected = lab.camera_model.texture.grey(*found[:, None])[0] * lamps
        assert image[pixel[1], pixel[0]] == pytest.approx(expected, abs=2e-3)  # float32; 1e-3 px is 0.05


def test_pattern_is_what_its_formula_says():
    settings = PatternSettings()
    texture = Texture(settings, 0.0015, 0.12, 0.08, np.random.default_rng(2))
    lattice = SpeckleSettings("blobs", 0.006, settings.spacing, settings.variability)
    centres = spot_centres(lattice, 0.12, 0.08, np.random.default_rng(2)).reshape(-1, 2)
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-0.06, 0.06, 400), rng.uniform(-0.04, 0.04, 400)
    squared = (x[:, None] - centres[:, 0]) ** 2 + (y[:, None] - centres[:, 1]) ** 2
    density = np.exp(-0.5 * squared / (0.006 / FWHM_SIGMAS) ** 2).sum(axis=1)
    grey = settings.dark + (settings.light - settings.dark) * np.exp(-settings.opacity * density)
    np.testing.assert_allclose(texture.grey(x, y), grey, atol=0.2)  # of the spline and the cut at five sigma
    assert grey.std() > 40


def test_gap_is_as_wide_as_it_opened():
    """The light that is missing between the halves, over that of the panel, is the width in pixels."""
    lab = make(
        pattern={"dark": 200.0, "light": 200.0},
        camera={"scale": 1.0, "lamp_gradient": 0.0},
        panel={"gap_grey": 0.0},
    )
    for time_s in (lab.reference_s, LOADED_S):
        image = lab.camera_model.instant(lab.moment(time_s))
        for y in (-0.1, 0.0, 0.2):
            left, right = (lab.project(np.array(side * 1.5e-4), np.array(y), time_s, side) for side in (-1, 1))
            row = round(left[1])
            col = round((left[0] + right[0]) / 2)
            missing = np.sum(1 - image[row, col - 12 : col + 13] / 200.0)
            assert missing == pytest.approx(right[0] - left[0], abs=0.05)


@pytest.mark.parametrize("exposure_s", [0.002, 0.012])
def test_blur_is_the_mean_over_the_exposure(exposure_s):
    lab = make(camera={"exposure_s": exposure_s, "scale": 0.5, "flicker": 0.1})
    model, time_s = lab.camera_model, 2.1
    moments = time_s + exposure_s * ((np.arange(24) + 0.5) / 24 - 0.5)
    mean = np.mean([model.lamps(t) * model.instant(lab.moment(t)) for t in moments], axis=0)
    sharp = np.mean([model.lamps(t) for t in moments]) * model.instant(lab.moment(time_s))
    inner = np.s_[150:380, 100:300]
    assert np.abs(model.radiance(time_s) / model.response - mean)[inner].max() < 0.05
    assert exposure_s < 0.01 or (model.motion_px(time_s) > 0.8 and np.abs(sharp - mean)[inner].max() > 0.5)


def test_photon_transfer(plain):
    """Variance of pairs of frames against their mean: one over the electrons a grey level, and the read noise."""
    model, s = plain.camera_model, plain.settings.camera
    light = model.radiance(LOADED_S)
    rng = np.random.default_rng(5)
    frames = np.array([plain.camera_model.expose(LOADED_S, rng) for _ in range(40)], float)
    mean, variance = frames.mean(axis=0).ravel(), frames.var(axis=0, ddof=1).ravel()
    slope, dark = np.polyfit(mean, variance, 1)
    k = s.full_well_e / 10 ** (s.gain_db / 20) / 255
    assert slope == pytest.approx(1 / k, rel=0.02)
    assert dark == pytest.approx((s.read_noise_e / k) ** 2 + 1 / 12, abs=0.1)
    assert abs(np.mean(frames.mean(axis=0) - light)) < 0.02 and light.max() < 250


def test_light_falls_off_flickers_and_changes_with_the_exposure():
    lab = make(camera={"noise": False, "exposure_factor": 0.6, "exposure_every_s": 1.0, "flicker": 0.1})
    model = lab.camera_model
    assert model.response[0, 0] == pytest.approx(0.75) and model.response[135, 180] == pytest.approx(1.0, abs=1e-3)
    ratio = model.radiance(1.5) / model.radiance(0.5)  # 100 Hz: the same phase
    assert np.median(ratio[0]) == pytest.approx(0.6, rel=1e-3)
    lamps = [model.lamps(t) for t in np.arange(0, 0.02, 1e-3)]
    assert np.ptp(lamps) == pytest.approx(0.2, abs=0.01) and np.mean(lamps) == pytest.approx(1.0)


def on_panel(lab, pose, depth_m, margin_m=0.02):
    """Points of a ToF frame in panel coordinates (N, 3), and which lie within the panel's outline."""
    points = (lab.tof_model.rays * depth_m[..., None]).reshape(-1, 3)
    at = lab.tof_model.pose(pose)
    placed = (points - at.t) @ at.R
    half = np.array([lab.settings.panel.width_m, lab.settings.panel.height_m]) / 2 - margin_m
    return points, placed, np.all(np.abs(placed[:, :2]) < half, axis=1) & (np.abs(placed[:, 2]) < 0.05)


def test_depth_without_noise_is_on_the_bent_panel(plain):
    moment = plain.moment(LOADED_S)
    depth, _ = plain.tof_model.look(moment)
    _, placed, inside = on_panel(plain, moment.pose, depth)
    x, y, z = placed[inside & (np.abs(placed[:, 0]) > 0.005)].T
    assert len(x) > 1500
    surface = plain.panel.points(x, y, moment.stroke_m)[:, 2]  # at the place, not the material: 3 mm off it at most
    np.testing.assert_allclose(z, surface, atol=1e-5)
    assert np.ptp(z) > 5e-4


def test_depth_has_the_residual_of_the_thesis():
    """RMS of z about the fitted plane over ten frames, as in 4.3.1: 4.97 mm, of 8000 pixels each to 0.3 %."""
    lab = make(tof={"scale": 0.5})
    squares = []
    for index in range(10):
        time_s = 0.1 + 0.5 * index
        frame = lab.depth(time_s, index)
        points, _, inside = on_panel(lab, lab.pose(time_s), frame.depth_m)
        used = points[inside & np.isfinite(points[:, 2])]
        plane = np.column_stack([used[:, :2], np.ones(len(used))])
        residual = used[:, 2] - plane @ np.linalg.lstsq(plane, used[:, 2], rcond=None)[0]
        squares.append(np.mean(residual**2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(0.00497, rel=0.02)
    with pytest.raises(SettingsError, match="no noise leave"):
        make(tof={"wiggle_m": 0.05})
    assert make(tof={"residual_rms_m": 0.0}).tof_model.noise_m == 0


def test_dark_reads_farther_and_noisier(plain):
    model, moment = plain.tof_model, plain.moment(0.1)
    depth, grey = model.look(moment)
    _, _, inside = on_panel(plain, moment.pose, depth)
    frames = [model.expose(moment, np.random.default_rng(i)).depth_m.ravel()[inside] for i in range(40)]
    error, noise, grey = (
        np.nanmean(frames, axis=0) - depth.ravel()[inside],
        np.nanstd(frames, axis=0),
        grey.ravel()[inside],
    )
    dark, light = grey < np.quantile(grey, 0.2), grey > np.quantile(grey, 0.8)
    expected = plain.settings.tof.dark_offset_m * (grey[light].mean() - grey[dark].mean()) / 200
    assert error[dark].mean() - error[light].mean() == pytest.approx(expected, abs=4e-4) and expected > 3e-4
    ratio = np.mean(grey[dark] ** -0.5) / np.mean(grey[light] ** -0.5)
    assert noise[dark].mean() / noise[light].mean() == pytest.approx(ratio, rel=0.03)


def test_wiggle_repeats_with_distance(plain):
    s, lengths = plain.settings.tof, np.linalg.norm(plain.tof_model.rays, axis=-1)
    white = np.full(lengths.shape, 200.0)
    one = plain.tof_model.systematic(2.0 / lengths, white)
    np.testing.assert_allclose(plain.tof_model.systematic((2.0 + s.wiggle_period_m) / lengths, white), one, atol=1e-12)
    half = plain.tof_model.systematic((2.0 + s.wiggle_period_m / 2) / lengths, white)
    assert np.ptp(
        [plain.tof_model.systematic(d / lengths, white)[0, 0] for d in np.linspace(2, 2.4, 99)]
    ) == pytest.approx(2 * s.wiggle_m, rel=0.01)
    assert np.std(one + half) / 2 == pytest.approx(s.fixed_pattern_m, rel=0.05)


def test_edges_fly_and_an_obstacle_hides(hard):
    """Between two depths only at edges; the bar is in both sensors where the rig says it is."""
    time_s = hard.settings.obstacle.start_s + 0.5 * hard.settings.obstacle.crossing_s
    moment = hard.moment(time_s)
    depth, _ = hard.tof_model.look(moment)
    frame = hard.depth(time_s, 3).depth_m
    off = np.abs(frame - depth) > 0.05
    assert 20 < off.sum() < 0.1 * off.size
    _, placed, _ = on_panel(hard, moment.pose, depth)
    bar = np.abs(placed[:, 2] + hard.settings.obstacle.distance_m) < 1e-9
    assert bar.sum() > 100
    np.testing.assert_allclose(placed[bar, 0].mean(), np.mean(moment.bar_m), atol=0.01)
    image = hard.camera_model.instant(moment)
    camera, pose = hard.calibration.camera, moment.pose
    middle = np.array([np.mean(moment.bar_m), 0.0, -hard.settings.obstacle.distance_m]) @ pose.R.T + pose.t
    col, row = np.rint(camera.distort(camera.project(middle))).astype(int)
    assert image[row, col] == pytest.approx(hard.settings.obstacle.grey)
    assert hard.moment(0.5).bar_m is None


def test_clocks_run_free_lose_frames_and_fall_silent(plain, hard):
    for lab, drops in ((plain, 0.0), (hard, 0.05)):
        camera, tof, s = lab.camera_ticks(), lab.tof_ticks(), lab.settings
        steps = np.diff(camera.exposed_ns) * 60e-9
        assert np.all(steps > 0.5) and np.all(np.diff(tof.exposed_ns) > 0)
        assert np.std(steps[steps < 1.5]) == pytest.approx(np.sqrt(2) * 60 * s.timing.jitter_s, rel=0.2)
        silent = (camera.exposed_ns > 4e9) & (camera.exposed_ns < 5e9)
        lost = 1 - len(camera.exposed_ns) / (60 * (s.duration_s - s.loss.gap_s))
        assert lost == pytest.approx(drops, abs=0.03) and silent.any() == (s.loss.gap_s == 0)
        assert tof.stamp_delay_ns == round(s.loss.tof_delay_s * 1e9)
    late = [frame for frame in hard.exposures() if frame.sensor == "tof"]
    assert late[5].stamp_ns * 1e-9 - late[5].time_s == pytest.approx(0.04) and late[5].index == 5
    assert hard.settings.loss.tof_delay_s == 0.04 and len(plain.tof_ticks().exposed_ns) == 120


def test_reference_is_late_noisy_and_else_the_truth(plain, tmp_path):
    stereo, s = plain.stereo, plain.settings.stereo
    plain.stereo.save(tmp_path / "reference.csv")
    rows = list(csv.DictReader((tmp_path / "reference.csv").open()))
    time_s = np.array([float(row["time_s"]) for row in rows])
    np.testing.assert_allclose(np.diff(time_s), 0.2, atol=2e-4)
    assert 0.25 <= stereo.delay_s <= 0.35 and len(rows) == 30
    opening = np.array([float(row["opening_mm"]) for row in rows]) * 1e-3

    def misfit(delay_s):
        return np.std(opening - [plain.crack(t - delay_s).opening_m for t in time_s])

    assert misfit(stereo.delay_s) == pytest.approx(s.noise_m, rel=0.5)
    delays = np.arange(0.2, 0.4, 0.005)
    assert delays[np.argmin([misfit(d) for d in delays])] == pytest.approx(stereo.delay_s, abs=0.005)
    assert make(seed=2).stereo.delay_s != stereo.delay_s


def test_frames_depend_on_the_seed_and_the_index_alone(plain):
    again = make()
    np.testing.assert_array_equal(again.image(LOADED_S, 7), plain.image(LOADED_S, 7))
    assert np.any(plain.image(LOADED_S, 8) != plain.image(LOADED_S, 7))
    np.testing.assert_array_equal(again.depth(0.5, 2).depth_m, plain.depth(0.5, 2).depth_m)


def test_bag_has_the_stamps_and_the_truth(tmp_path):
    settings = laboratory_settings(
        "laboratory", {**SMALL, "duration_s": 0.5, "loss": {"tof_delay_s": 0.04}, "press": {"still_s": 0.1}}
    )
    summary = simulate_laboratory(settings, tmp_path / "lab")
    lab = Laboratory(settings)
    assert summary.counts["/camera/image_raw"] == 30 and summary.counts["/tof/depth/image_raw"] == 10
    rows = list(csv.DictReader((tmp_path / "lab" / "truth.csv").open()))
    with BagReader(tmp_path / "lab") as bag:
        topics = ["/tof/depth/image_raw", "/camera/image_raw", "/crack_opening_truth"]
        messages = {topic: [m for _, _, m in bag.messages([topic])] for topic in topics}
    stamps = [stamp_to_ns(m.header.stamp) - START_NS for m in messages["/tof/depth/image_raw"]]
    np.testing.assert_array_equal(stamps, lab.tof_ticks().exposed_ns + 40_000_000)
    assert [int(row["stamp_ns"]) for row in rows] == [
        stamp_to_ns(m.header.stamp) for m in messages["/camera/image_raw"]
    ]
    crack = lab.crack(lab.camera_ticks().exposed_ns[-1] * 1e-9)
    assert float(rows[-1]["opening_mm"]) == pytest.approx(1e3 * crack.opening_m, abs=1e-8)
    assert messages["/crack_opening_truth"][-1].opening == pytest.approx(crack.opening_m)
    assert crack.opening_m > 1e-5
    told = yaml.safe_load((tmp_path / "lab" / "laboratory.yaml").read_text())
    assert told["reference_delay_s"] == lab.stereo.delay_s and told["tof_delay_s"] == 0.04
    assert laboratory_settings("laboratory", told["settings"]) == settings
    assert yaml.safe_load((tmp_path / "lab" / "regions.yaml").read_text()) == lab.regions
    assert Path(tmp_path / "lab" / REFERENCE_FILE).exists()
