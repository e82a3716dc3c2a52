"""HostClock against clocks whose true relation is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rgbd_dic_acquisition.clock import NS, HostClock
from rgbd_dic_acquisition.errors import SettingsError

HOST_START_NS = 1_700_000_000 * NS
DEVICE_START_NS = 12_345 * NS


def _flight(seed: int, seconds: float, rate_hz: float, drift: float, delivery_s, resolution_ns: int = 1):
    """Events evenly in host time: (true host time, device time, arrival), all [ns]."""
    rng = np.random.default_rng(seed)
    host = (np.arange(int(seconds * rate_hz)) / rate_hz * NS).astype(np.int64)
    device = np.floor(host * (1 - drift)).astype(np.int64) // resolution_ns * resolution_ns
    arrival = np.maximum.accumulate(host + (delivery_s(rng, host.size) * NS).astype(np.int64))
    return host + HOST_START_NS, device + DEVICE_START_NS, arrival + HOST_START_NS


def _jittery(rng, n):
    """Mostly 1 ms, one packet in twenty up to 80 ms: a busy USB or radio link."""
    return rng.exponential(1e-3, n) + np.where(rng.random(n) < 0.05, rng.uniform(0, 80e-3, n), 0)


@pytest.mark.parametrize("drift", [-100e-6, 0.0, 40e-6, 200e-6])
@pytest.mark.parametrize("rate_hz", [20.0, 60.0])
def test_a_drifting_clock_with_jittery_delivery_is_followed(drift, rate_hz):
    clock = HostClock()
    truth, device, arrival = _flight(1, 120, rate_hz, drift, _jittery)
    stamps = [clock.stamp(int(d), int(a)) for d, a in zip(device, arrival, strict=True)]
    errors_s = (np.array([s.stamp_ns for s in stamps]) - truth) / NS
    settled = errors_s[truth - truth[0] > 10 * NS]
    # Without the rate the oldest point of the window alone would be off by 30 s x 100 ppm = 3 ms; half a
    # millisecond is half the mean delivery and a quarter of what pairing needs.
    assert np.max(np.abs(settled)) < 0.5e-3
    assert np.all(errors_s < 0.1)
    uncertainty_s = np.array([s.uncertainty_ns for s in stamps])[truth - truth[0] > 10 * NS] / NS
    assert np.sqrt(np.mean(settled**2)) < 2 * np.mean(uncertainty_s)
    assert np.mean(uncertainty_s) < 1e-3


def test_stamps_are_monotone_and_never_after_arrival():
    clock = HostClock()
    _, device, arrival = _flight(2, 60, 60, 50e-6, _jittery)
    stamps = np.array([clock.stamp(int(d), int(a)).stamp_ns for d, a in zip(device, arrival, strict=True)])
    assert np.all(np.diff(stamps) > 0)
    assert np.all(stamps <= arrival)


def test_coarse_device_time_has_no_bias():
    """Milliseconds cut off, as MAVLink has them: the mean error is far below one step."""
    clock = HostClock(resolution_ns=1_000_000)
    truth, device, arrival = _flight(
        3, 60, 47.3, 20e-6, lambda rng, n: rng.exponential(2e-4, n), resolution_ns=1_000_000
    )
    stamps = [clock.stamp(int(d), int(a)) for d, a in zip(device, arrival, strict=True)]
    errors_ns = np.array([s.stamp_ns for s in stamps])[500:] - truth[500:]
    assert abs(np.mean(errors_ns)) < 0.2e6
    assert stamps[-1].uncertainty_ns >= 1e6 / math.sqrt(12)


def test_two_devices_pair_within_two_milliseconds():
    """60 and 20 Hz, skewed and drifting against each other: nearest stamps are the nearest exposures."""
    fast, slow = HostClock(), HostClock()
    truth_f, device_f, arrival_f = _flight(4, 60, 60, 80e-6, _jittery)
    truth_s, device_s, arrival_s = _flight(5, 60, 20, -60e-6, _jittery)
    stamps_f = np.array([fast.stamp(int(d), int(a)).stamp_ns for d, a in zip(device_f, arrival_f, strict=True)])
    stamps_s = np.array([slow.stamp(int(d), int(a)).stamp_ns for d, a in zip(device_s, arrival_s, strict=True)])
    late = truth_f - truth_f[0] > 10 * NS
    nearest = np.argmin(np.abs(stamps_s[None, :] - stamps_f[late, None]), axis=1)
    offsets = stamps_f[late] - stamps_s[nearest]
    true_offsets = truth_f[late] - truth_s[nearest]
    assert np.max(np.abs(offsets - true_offsets)) < 2e6


def test_a_known_delay_is_taken_off():
    clock = HostClock(fixed_delay_ns=5_000_000)
    truth, device, arrival = _flight(6, 20, 50, 0, lambda rng, n: 5e-3 + rng.exponential(1e-3, n))
    stamps = [clock.stamp(int(d), int(a)).stamp_ns for d, a in zip(device, arrival, strict=True)]
    assert abs(stamps[-1] - truth[-1]) < 0.3e6


def test_a_restart_of_the_device_begins_anew():
    clock = HostClock()
    for k in range(500):
        clock.stamp(1000 * NS + k * NS // 50, HOST_START_NS + k * NS // 50 + 3_000_000)
    rebooted = clock.stamp(0, HOST_START_NS + 20 * NS)
    assert clock.restarts == 1
    assert rebooted.stamp_ns == HOST_START_NS + 20 * NS
    assert math.isinf(rebooted.uncertainty_ns)


def test_an_overtaken_packet_keeps_its_place():
    clock = HostClock()
    for k in range(100):
        clock.stamp(k * 10_000_000, HOST_START_NS + k * 10_000_000)
    late = clock.stamp(985_000_000, HOST_START_NS + 1_000_000_000)
    assert late.stamp_ns == HOST_START_NS + 985_000_000
    assert clock.restarts == 0


def test_a_bad_window_is_refused():
    with pytest.raises(SettingsError, match="window_ns"):
        HostClock(window_ns=0)
