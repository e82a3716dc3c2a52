"""What the peers sent against what is in the bag: frames, their content, their stamps, when faults were told."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from flight_peers import AUTOPILOT, CAMERA, DELIVERY_S, PERIODS_S, sent
from numpy.typing import NDArray
from recorded import FRAME_TOPICS, MIDDLE_NS, Recorded
from rendered_flight import R_FLU_FRD, R_NED_ENU, RenderedFlight
from rgbd_dic_acquisition.nodes.diagnostics import STAMPS
from rgbd_dic_acquisition.simulator.motion import attitude
from scipy.spatial.transform import Rotation
from session import NODES, Flown

NEAR_NS = 500_000_000  # no stamp is so wrong that an attitude is not found within this
SAME_RAD = 3e-6  # single precision on the way
TRUE_RAD = 1e-4  # and steps of the table of attitudes
# How many standard uncertainties a stamp may be off. Half the gap between two bounds is sqrt(3) of them, and more than
# three are out of the question but for what the computer does between the two lines that read its clocks.
SIGMAS, READING_NS = 3.0, 100_000
ON_THE_WAY_NS = 20_000_000  # by which a frame and a status may be recorded in another order than they were sent
WARN = 1


@dataclass
class Account:
    """One peer's frames in the part that counts.

    Attributes:
        sent, recorded: how many; recorded is with all messages of a frame.
        in_fault: sent, from a frame before the peer failed to the first that was recorded after it came back.
        lost: sent outside the fault, and not recorded whole.
        told_s: from the failure to the WARN of the node; back_s: from the return to the first frame recorded.
        errors_ns: of the stamps, one a recorded frame.
        wrong: frames with a stamp beyond its stated uncertainty, out of order, of no frame, or with another content.
        stated_ns: median of the standard uncertainty stated.
        unstated: frames before any was stated.
        true_ns: stamp -> the moment of exposure by the peer's own record; index: stamp -> what it showed.
    """

    sent: int = 0
    recorded: int = 0
    in_fault: int = 0
    lost: int = 0
    told_s: float = math.nan
    back_s: float = math.nan
    errors_ns: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    wrong: list[str] = field(default_factory=list)
    stated_ns: float = math.nan
    unstated: int = 0
    true_ns: dict[int, int] = field(default_factory=dict)
    index: dict[int, int] = field(default_factory=dict)


def account(peer: str, folder: Path, flown: Flown, recorded: Recorded, rendered: RenderedFlight) -> Account:
    """All about one peer."""
    made, written = Account(), sent(folder, peer)
    whole = set.intersection(*(set(recorded.stamps[topic]) for topic in FRAME_TOPICS[peer]))
    found = {}
    for stamp_ns in sorted(whole):
        known = recorded.shown(peer, stamp_ns) if peer != AUTOPILOT else None
        if known is not None:
            found[stamp_ns], made.index[stamp_ns] = known
    if peer == AUTOPILOT:
        found = _attitudes(written, recorded, rendered, made)
    made.true_ns = found
    made.wrong += [f"{stamp} belongs to no frame that was sent" for stamp in whole if stamp not in found]
    if peer != AUTOPILOT:
        made.wrong += [f"{stamp} has another content" for stamp in recorded.other_content[peer]]
    _judge_stamps(peer, made, recorded)
    _count(peer, made, flown, written, recorded)
    return made


def _attitudes(written: NDArray, recorded: Recorded, rendered: RenderedFlight, made: Account) -> dict[int, int]:
    """Stamp -> moment: of the attitudes that were sent at about that time, the one that is the same."""
    moments_ns = written[:, 0]
    R_enu_ned, R_frd_flu = Rotation.from_matrix(R_NED_ENU).inv(), Rotation.from_matrix(R_FLU_FRD).inv()
    flown = R_enu_ned * Rotation.from_quat(np.roll(written[:, 1:], -1, axis=1)) * R_frd_flu
    found = {}
    for stamp_ns, quaternion in recorded.attitudes:
        near = np.flatnonzero(np.abs(moments_ns - stamp_ns) < NEAR_NS)
        measured = Rotation.from_quat(quaternion)
        same = near[(flown[near].inv() * measured).magnitude() < SAME_RAD] if near.size else near
        if same.size:
            moment_ns = int(moments_ns[same[np.argmin(np.abs(moments_ns[same] - stamp_ns))]])
            found[stamp_ns] = moment_ns
            truth = Rotation.from_matrix(attitude(rendered.flight.pose(rendered.time_s(moment_ns))))
            if (truth.inv() * measured).magnitude() > TRUE_RAD:
                made.wrong.append(f"{stamp_ns} has another attitude than the flight")
    return found


def _judge_stamps(peer: str, made: Account, recorded: Recorded) -> None:
    """Each within what the node says of its clock at that time."""
    stamps = np.array(sorted(made.true_ns), np.int64)
    late_ns = MIDDLE_NS if peer == CAMERA else 0
    made.errors_ns = np.array([stamp - made.true_ns[int(stamp)] - late_ns for stamp in stamps], float)
    times, stated, by_arrival = _stated(peer, recorded)
    log_ns = np.array([recorded.stamps[FRAME_TOPICS[peer][0]][int(stamp)] for stamp in stamps])
    # A status has the largest since the one before; which one follows a frame is known to within its way here.
    next_ones = [
        np.minimum(np.searchsorted(times, moments), times.size - 1) for moments in (stamps, log_ns + ON_THE_WAY_NS)
    ]
    uncertainty, by_arrival = (
        np.array([np.max(each[first : last + 1]) for first, last in zip(*next_ones, strict=True)])
        for each in (stated, by_arrival)
    )
    delivery_ns = DELIVERY_S * 1e9 if peer == AUTOPILOT else 0.0
    allowed = SIGMAS * uncertainty + READING_NS + np.where(by_arrival, delivery_ns, 0.0)
    made.unstated = int(np.sum(~np.isfinite(allowed)))
    made.stated_ns = (
        float(np.median(uncertainty[np.isfinite(uncertainty)])) if np.any(np.isfinite(uncertainty)) else math.nan
    )
    for stamp, error, limit in zip(stamps, made.errors_ns, allowed, strict=True):
        if abs(error) > limit:
            made.wrong.append(f"{stamp} is off by {error * 1e-6:.3f} ms, where {limit * 1e-6:.3f} ms are explained")
    order = np.array([made.true_ns[int(stamp)] for stamp in stamps])
    made.wrong += [f"{stamps[k + 1]} is out of order" for k in np.flatnonzero(np.diff(order) <= 0)]


def _stated(peer: str, recorded: Recorded) -> tuple[NDArray, NDArray, NDArray]:
    """What the node said of its stamps: times, standard uncertainty [ns], whether they lack the time on the way."""
    rows = []
    for log_ns, _, _, values in recorded.said[NODES[peer]]:
        uncertainty_ns = 1e6 * float(values.get(STAMPS, "inf"))
        rows.append((log_ns, uncertainty_ns, values.get("stamps by") == "arrival"))
    times, stated, by_arrival = zip(*rows, strict=True)
    return np.array(times), np.array(stated), np.array(by_arrival)


def _count(peer: str, made: Account, flown: Flown, written: NDArray, recorded: Recorded) -> None:
    moments = np.sort(written[:, 0 if peer == AUTOPILOT else 1].astype(np.int64))
    moments = moments[(moments >= flown.begin_ns) & (moments < flown.end_ns)]
    log_ns = {moment: recorded.stamps[FRAME_TOPICS[peer][0]][stamp] for stamp, moment in made.true_ns.items()}
    got = np.array(sorted(log_ns), np.int64)
    ill_ns, well_ns = flown.faults[peer]
    back_ns = _first_after(got, ill_ns, well_ns)
    in_transit_ns = round(1e9 * (PERIODS_S[peer] + (DELIVERY_S if peer == AUTOPILOT else 0.0)))
    in_fault = (moments >= ill_ns - in_transit_ns) & (moments < back_ns)
    here = np.isin(moments, got)
    made.sent, made.recorded = moments.size, int(np.sum(here))
    made.in_fault, made.lost = int(np.sum(in_fault)), int(np.sum(~here & ~in_fault))
    if back_ns in log_ns:
        made.back_s = max(0.0, (log_ns[back_ns] - well_ns) * 1e-9)
    warned = [log for log, level, _, _ in recorded.said[NODES[peer]] if level == WARN and log >= ill_ns]
    if warned:
        made.told_s = (min(warned) - ill_ns) * 1e-9


def _first_after(got: NDArray, ill_ns: int, well_ns: int) -> int:
    """Moment of the first frame recorded after the silence that the failure made."""
    silences = np.flatnonzero(np.diff(got) > (well_ns - ill_ns) / 2)
    later = [int(got[k + 1]) for k in silences if got[k + 1] > ill_ns]
    return later[0] if later else np.iinfo(np.int64).max
