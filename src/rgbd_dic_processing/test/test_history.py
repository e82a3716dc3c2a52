"""Histories beside a reference, their spectra and their zones, against truth that is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.errors import RgbdDicError, SettingsError
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.displacement_field import DisplacementField
from rgbd_dic_processing.core.regions import CrackZones
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.history.alignment import align, difference
from rgbd_dic_processing.history.comparison import compare_histories, compare_run
from rgbd_dic_processing.history.interpolation import INTERPOLATIONS
from rgbd_dic_processing.history.record import History, history_of, read_reference
from rgbd_dic_processing.history.settings import AlignmentSettings
from rgbd_dic_processing.history.spectrum import spectrum
from rgbd_dic_processing.history.zone_sensitivity import ACROSS, ALONG, BOTH, LEFT, RIGHT, zone_sensitivity

DELAY = 0.2973
BOTH_WAYS = pytest.mark.parametrize("interpolation", list(INTERPOLATIONS))


def opening(t):
    """Of a press that does not follow its 0.5 Hz well, with some drift: not periodic in any record [m]."""
    return 3e-4 * np.sin(np.pi * t) + 4e-5 * np.sin(2 * np.pi * t + 0.4) + 1e-5 * t


def record(t, values):
    return History(t, values, np.full(len(t), np.nan))


def pair(seed=0, noise=3e-6, reference_noise=3e-6, length=10.0):
    """60 Hz with jitter, 5 % of the frames lost and a gap of half a second; and 5 Hz, later by DELAY."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, length, 1 / 60)
    t = t + rng.normal(0, 3e-4, len(t))
    ours = opening(t) + noise * rng.standard_normal(len(t))
    ours[rng.random(len(t)) < 0.05] = np.nan
    ours[200:230] = np.nan
    at = np.arange(0.07, length, 0.2)
    return record(t, ours), record(at + DELAY, opening(at) + reference_noise * rng.standard_normal(len(at)))


@BOTH_WAYS
def test_delay_is_found_within_its_uncertainty(interpolation):
    """Of 40 records: errors over their uncertainties have an RMS of 1, known to 11 %; 0.5 to 1.25 allows for three of
    those and for the second order's own part of u, a limit and not a scatter. An uncertainty of 0.1 step is useful."""
    found = [align(*pair(seed), interpolation) for seed in range(40)]
    error = np.array([one.delay_s - DELAY for one in found])
    u = np.array([one.u_delay_s for one in found])
    assert 0.5 < np.sqrt(np.mean((error / u) ** 2)) < 1.25
    assert np.median(u) < 0.002 and np.abs(error).max() < 0.005


@BOTH_WAYS
def test_delay_without_noise_is_below_a_step(interpolation):
    """What the second order leaves of a peak that is not quite even: u tells it, a tenth of a step at most."""
    found = align(*pair(noise=0.0, reference_noise=0.0), interpolation)
    assert abs(found.delay_s - DELAY) < min(1e-3, 2 * found.u_delay_s)
    assert found.opening.correlation > 0.9999
    assert found.similar_s == ()


@BOTH_WAYS
def test_rms_of_a_known_difference(interpolation):
    """Noise-free histories and a known zigzag on the reference, by Eq. 3.1; 1e-7 m is what 0.5 ms of delay leaves at
    the slope of 1e-3 m/s, and the interpolations at the ends."""
    ours, reference = pair(noise=0.0, reference_noise=0.0)
    zigzag = 2e-5 * (-1.0) ** np.arange(len(reference.time_s))
    other = replace(reference, opening_m=reference.opening_m + zigzag + 1.5e-4)
    found = align(ours, other, interpolation)
    used = np.isin(np.round(other.time_s, 6), np.round(found.time_s + found.delay_s, 6))
    assert found.opening.n == used.sum() < len(used)  # some rows are in the gap
    expected = zigzag[used] - zigzag[used].mean()
    assert found.opening.rms_m == pytest.approx(np.sqrt(np.sum(expected**2) / (used.sum() - 1)), abs=1e-6)
    assert found.opening.offset_m == pytest.approx(-1.5e-4 - zigzag[used].mean(), abs=1e-6)
    as_is = np.sqrt(np.sum((zigzag[used] + 1.5e-4) ** 2) / (used.sum() - 1))
    assert found.opening.rms_as_is_m == pytest.approx(as_is, abs=1e-6)


def test_difference_by_hand():
    """Errors of 1, 2 and 3 m: Eq. 3.1 gives sqrt(14 / 2), and 1 about their mean."""
    found = difference(np.array([2.0, 4.0, np.nan, 7.0]), np.array([1.0, 2.0, 3.0, 4.0]))
    assert (found.n, found.offset_m, found.rms_m) == (3, 2.0, 1.0)
    assert found.rms_as_is_m == pytest.approx(np.sqrt(7))


@BOTH_WAYS
def test_interpolation_follows_the_history_and_fills_no_gap(interpolation):
    """Inside; Gibbs' ripples of the slopes that do not close at the ends stay below 1 % of the amplitude."""
    t = np.arange(0, 10, 1 / 60)
    values = opening(t)
    values[200:230] = np.nan
    curve = INTERPOLATIONS[interpolation](t, values)
    at = np.concatenate([np.linspace(0.02, 3.2, 500), np.linspace(3.9, 9.9, 500)])
    assert np.abs(curve(at) - opening(at)).max() < 3e-6
    inner = np.concatenate([np.linspace(1, 3, 300), np.linspace(5, 9, 300)])
    assert np.abs(curve(inner) - opening(inner)).max() < 3e-7
    assert np.isnan(curve(np.array([-0.01, 3.5, 3.8, 10.1]))).all()


def test_frequency_and_amplitude_of_a_sine_in_spite_of_gaps():
    """Exact but for the parabola through three lines of the padded spectrum, and the leakage of the sine's mirror."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 12.7, 1 / 60) + 5.0
    t = t + rng.normal(0, 3e-4, len(t))
    values = 1.3e-3 + 2.5e-4 * np.cos(2 * np.pi * 0.4823 * t + 0.7)
    values[rng.random(len(t)) < 0.2] = np.nan
    values[300:360] = np.nan
    found = spectrum(t, values)
    assert found.dominating_hz == pytest.approx(0.4823, abs=5e-4)
    assert found.dominating == pytest.approx(2.5e-4, rel=5e-3)
    assert found.frequency_hz[0] >= 1 / 12.8 and found.frequency_hz[-1] <= 30.1
    assert len(found.frequency_hz) == len(found.amplitude)


def test_record_without_oscillation_has_no_dominating_frequency():
    found = spectrum(np.arange(100.0), np.zeros(100))
    assert np.isnan(found.dominating_hz) and np.isnan(found.dominating)


def test_both_histories_are_compared_with_sliding_and_spectra():
    ours, reference = pair()
    ours = replace(ours, sliding_m=0.1 * ours.opening_m)
    reference = replace(reference, sliding_m=0.1 * reference.opening_m + 2e-5)
    found = compare_histories(ours, reference)
    assert found.sliding["spline"].offset_m == pytest.approx(-2e-5, abs=1e-6)
    # 0.1 of both noises of 3e-6, and of the 5e-4 s that the delay may be off at a slope of 1e-3 m/s
    assert found.sliding["fourier"].rms_m < 6e-7
    for one in (found.ours, found.reference):
        assert one.dominating_hz == pytest.approx(0.5, abs=2e-3)
        assert one.dominating == pytest.approx(3e-4, rel=0.02)  # the drift leaks into it


def test_a_single_cycle_is_no_peak_of_the_spectrum():
    time_s = np.arange(144) / 60
    found = spectrum(time_s, np.sin(2 * np.pi * 0.4 * time_s) + 0.01 * np.cos(np.pi * np.arange(144)))
    assert np.isnan(found.dominating_hz)  # the highest peak is a side lobe of the one cycle
    # A sine of half the sampling rate looks larger than it is where it meets its mirror image.
    assert found.amplitude[found.frequency_hz > 25].max() < 0.0105


def measured(k, method="h_pose", reference_ns=0, valid=True, value=None):
    status = FrameStatus.OK if valid else FrameStatus.LOST
    length = opening(k / 60) if value is None else value
    return CrackOpening(
        10**18 + round(k / 60 * 1e9), reference_ns, method, status, "", *([length] * 2), np.nan, length, 1e-6,
        *([np.nan] * 3), 9, 9, 0.0,
    )  # fmt: skip


def test_methods_of_a_run_that_cannot_be_compared_have_their_reason():
    _, reference = pair()
    run = [measured(k) for k in range(600)]
    run += [measured(k, "h_2d", reference_ns=k // 300) for k in range(600)]
    run += [measured(k, "h_3d", valid=k < 5) for k in range(600)]
    good, renewed, lost = compare_run(run, reference, 10**18)
    assert good.comparison.alignments["spline"].delay_s == pytest.approx(DELAY, abs=3e-3)
    assert renewed.comparison is None and "2 references" in renewed.reason
    assert lost.comparison is None and "5 valid values" in lost.reason
    with pytest.raises(RgbdDicError, match="h_3d: 5 valid values"):
        compare_run(run[1200:], reference, 10**18)
    assert np.isnan(history_of(run, "h_3d", 10**18).opening_m[5:]).all()


def changed(**changes):
    ours, reference = pair()
    return ours, replace(reference, **changes)


@pytest.mark.parametrize(
    ("histories", "says"),
    [
        (changed(time_s=pair()[1].time_s + 60), r"choose shifts .* near 60\.\d s"),
        (changed(opening_m=np.full(50, 2e-4)), "the reference is constant"),
        ((record(pair()[0].time_s, np.zeros(600)), pair()[1]), "our history is constant"),
        (changed(opening_m=1e-4 * np.random.default_rng(1).standard_normal(50)), "not alike"),
    ],
    ids=["no overlap", "constant reference", "constant history", "noise"],
)
def test_what_has_no_delay_is_refused(histories, says):
    with pytest.raises(RgbdDicError, match=says):
        align(*histories)


def test_opposite_sign_is_named():
    t = np.arange(0, 10, 1 / 60)
    bump = np.exp(-((t - 5) ** 2))
    with pytest.raises(RgbdDicError, match="sign of one history the other way round"):
        align(record(t, bump), record(t[::12], -bump[::12]), settings=AlignmentSettings(-0.5, 0.5))


def test_delay_beyond_the_shifts_is_refused_or_told():
    """A delay of 1.0473 s; the loading repeats itself after two, so -0.9527 s fits nearly as well."""
    ours, reference = pair()
    late = replace(reference, time_s=reference.time_s + 0.75)
    with pytest.raises(RgbdDicError, match=r"border of the shifts, \+1.00 s"):
        align(ours, late, settings=AlignmentSettings(-0.5, 1.0))
    found = align(ours, late)
    assert found.delay_s == pytest.approx(DELAY + 0.75 - 2, abs=0.02) and found.similar_s == (1.0,)


def test_repetition_is_told():
    """A sine of 1 Hz fits again a second earlier and later."""
    t = np.arange(0, 20, 1 / 60)
    at = np.arange(0.1, 20, 0.2)
    ours, reference = (record(x + late, np.sin(2 * np.pi * x)) for x, late in ((t, 0.0), (at, 0.3)))
    found = align(ours, reference, settings=AlignmentSettings(-0.9, 0.9))
    near = sorted([found.delay_s, *found.similar_s])
    np.testing.assert_allclose(near, [-0.7, 0.3], atol=0.006)  # other shifts are given to half a step


def test_shifts_must_make_a_range():
    with pytest.raises(SettingsError, match="width of the fit"):
        AlignmentSettings(0.5, 0.6)
    with pytest.raises(SettingsError, match="two steps"):
        AlignmentSettings(step_s=0.08)


def rows(header="time_s,opening_mm", count=12, clock=lambda i: f"{0.2 * i:.1f}", value=lambda i: f"{0.1 * i:.2f}"):
    return header + "\n" + "".join(f"{clock(i)},{value(i)}\n" for i in range(count))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (rows("t,opening_mm"), "lacks the column time_s or stamp_ns; it has t, opening_mm"),
        (rows("time_s,width"), "lacks the column opening_mm"),
        (rows(count=9), "9 rows with an opening, at least 10"),
        ("", "0 rows"),
        (rows(clock=lambda i: f"{min(i, 7)}.0"), r"row 9: time_s 7.0 is not after 7.0"),
        (rows(clock=lambda i: "noon" if i == 3 else i), "row 4: time_s is 'noon'"),
        (rows(value=lambda i: "wide" if i == 3 else i), "row 4: opening_mm is 'wide'"),
        (rows(value=lambda i: "" if i % 2 else i), "6 rows with an opening"),
        (rows("stamp_ns,opening_mm", clock=lambda i: f"{i}.5"), "stamp_ns is '0.5'"),
    ],
)
def test_bad_reference_files_are_refused(text, says, tmp_path):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(RgbdDicError, match=says):
        read_reference(tmp_path / "r.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
    for name in ("b.csv", "none.csv"):
        with pytest.raises(RgbdDicError, match=name):
            read_reference(tmp_path / name)


def test_reference_file_is_read_by_either_clock(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("\ufefftime_s,opening_mm,sliding_mm\n" + "".join(f"{0.2 * i},{i},\n" for i in range(12)))
    read = read_reference(path, start_ns=10**18)
    np.testing.assert_allclose(read.time_s, 0.2 * np.arange(12))
    np.testing.assert_allclose(read.opening_m, 1e-3 * np.arange(12))
    assert np.isnan(read.sliding_m).all()
    path.write_text(rows("stamp_ns,opening_mm", clock=lambda i: 10**18 + 5 * 10**7 * i))
    np.testing.assert_allclose(read_reference(path, 10**18).time_s, 0.05 * np.arange(12), atol=1e-12)


GRADIENTS = {"left": np.array([3e-6, -2e-6]), "right": np.array([-1e-6, 5e-6])}  # of the displacement in x [m/px]


def linear_field(torn=()):
    """Displacement across an upright crack at x = 200 px, linear in each half; 2 mm/px, the panel turned by 0.1 rad."""
    centres = np.stack(np.meshgrid(np.arange(20, 381, 8), np.arange(20, 301, 8)), axis=-1).reshape(-1, 2)
    moved = np.where(centres[:, 0] < 200, centres @ GRADIENTS["left"], 1e-3 + centres @ GRADIENTS["right"])
    along = np.array([np.sin(0.1), np.cos(0.1)])
    across = np.array([np.cos(0.1), -np.sin(0.1)])
    displacement = np.column_stack([np.outer(moved, across) + np.outer(3e-4 * np.sign(centres[:, 0] - 200), along),
                                    np.full(len(centres), np.nan)])  # fmt: skip
    displacement[list(torn)] = np.nan
    position = 2e-3 * (np.outer(centres[:, 0], across) + np.outer(centres[:, 1], along))
    return DisplacementField(
        1, 0, 0, "h_pose", FrameStatus.OK, "", 0.0, 15.0, centres.astype(np.float32), position, displacement,
        np.full(displacement.shape, 1e-6, np.float32), np.zeros((0, 3, 6)), np.zeros(0, np.uint8),
        np.zeros((0, 2, 3)), 0.0, np.nan, 0.0,
    )  # fmt: skip


ZONES = CrackZones.from_point(np.array([200.0, 150.0]), np.array([0.0, 1.0]), 60, 100, 30)


@pytest.mark.parametrize("torn", [(), (900, 901, 950)], ids=["whole", "with holes"])
def test_sensitivity_of_a_linear_field_is_its_gradient(torn):
    """Linear interpolation of a linear map is exact, so only rounding is left (float32 centres are whole numbers)."""
    found = {(one.moved, one.axis): one for one in zone_sensitivity(linear_field(torn), ZONES, 6)}
    for i, axis in enumerate((ACROSS, ALONG)):
        left, right = GRADIENTS["left"][i], GRADIENTS["right"][i]
        expected = {LEFT: -left, RIGHT: right, BOTH: right - left}
        for moved, slope in expected.items():
            one = found[moved, axis]
            assert one.slope == pytest.approx(slope, abs=1e-12)
            np.testing.assert_allclose(one.opening_m - one.opening_m[6], slope * one.shift_px, atol=1e-11)
    middles = [one.opening_m[6] for one in found.values()]
    np.testing.assert_allclose(middles, middles[0], atol=2e-6 if torn else 1e-12)


def test_zone_at_the_edge_has_no_sensitivity():
    narrow = CrackZones.from_point(np.array([200.0, 300.0]), np.array([0.0, 1.0]), 60, 6, 30)
    with pytest.raises(RgbdDicError, match="too small or too near the edge"):
        zone_sensitivity(linear_field(), narrow)
    empty = CrackZones.from_point(np.array([500.0, 150.0]), np.array([0.0, 1.0]), 20, 20, 30)
    with pytest.raises(RgbdDicError, match="0 subsets in the measuring zones"):
        zone_sensitivity(linear_field(), empty)
