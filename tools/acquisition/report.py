"""The tables of a session in Markdown, and what is not as it should be."""

from __future__ import annotations

import numpy as np
from accounting import Account
from blocks import table
from flight_peers import CAMERA, PERIODS_S
from recorded import Recorded
from replay import PAIRING_S, Replayed
from session import Flown

# A fault is told after so many periods and so long, and mended so soon after the peer came back.
PERIODS, TOLD_S, BACK_S = 3, 0.2, 3.0


def told_within_s(peer: str) -> float:
    return PERIODS * PERIODS_S[peer] + TOLD_S


def tables(flown: Flown, recorded: Recorded, accounts: dict[str, Account], measured: Replayed) -> str:
    """All that was counted and measured."""
    seconds = (flown.end_ns - flown.begin_ns) * 1e-9
    frames = table(
        ["Peer", "Sent", "Recorded", "Sent in its fault", "Lost outside", "Told after [s]", "Back after [s]"],
        [_frames(peer, each) for peer, each in accounts.items()],
    )
    stamps = table(
        ["Stamps of", "Median error [ms]", "Largest [ms]", "Stated, median [ms]", "Before any was stated", "Wrong"],
        [_stamps(peer, each) for peer, each in accounts.items()],
    )
    cores = table(
        ["Node", "Processor [% of a core]"], [[name, f"{100 * share:.1f}"] for name, share in flown.cores.items()]
    )
    pairing = measured.pairing
    offsets_ms = 1e3 * pairing.offsets_s
    pairs = (
        f"*Pairing*: {offsets_ms.size} images have a ToF frame, {pairing.unpaired} have none; offset RMS "
        f"{np.sqrt(np.mean(offsets_ms**2)):.1f} ms, largest {np.max(np.abs(offsets_ms)):.1f} ms; at most "
        f"{1e3 * pairing.worst_error_s:.2f} ms from what the peers wrote down; {pairing.mispaired} with another frame "
        "nearer."
    )
    opening = (
        f"*Opening*, from the recording: {measured.valid} of {measured.openings} images valid, the truth varies by "
        f"{1e3 * measured.range_m:.3f} mm, RMS error {1e3 * measured.rms_m:.4f} mm, explained by noise: up to "
        f"{1e3 * measured.bound_m:.4f} mm."
    )
    live = (
        f"{seconds:.0f} s were flown. Of {accounts[CAMERA].recorded} images recorded in them, {recorded.openings} had "
        "an opening in flight."
    )
    return "\n\n".join((live, frames, stamps, cores, pairs, opening)) + "\n"


def failures(accounts: dict[str, Account], measured: Replayed, timed: bool) -> list[str]:
    """What makes the exit code 1; the times of the faults only if they are asked for."""
    found = []
    for peer, each in accounts.items():
        if each.lost:
            found.append(f"{each.lost} frames of the {peer} were lost outside its fault")
        if each.wrong:
            found.append(f"{len(each.wrong)} frames of the {peer} are wrong: {each.wrong[0]}")
        if not each.recorded:
            found.append(f"nothing of the {peer} was recorded")
        if timed and not each.told_s <= told_within_s(peer):
            found.append(f"the fault of the {peer} was told after {each.told_s:.2f} s, not {told_within_s(peer):.2f}")
        if timed and not each.back_s <= BACK_S:
            found.append(f"the {peer} was back after {each.back_s:.2f} s, not {BACK_S}")
    if not measured.rms_m <= measured.bound_m:
        found.append(f"the RMS error of the opening is {1e3 * measured.rms_m:.4f} mm, not {1e3 * measured.bound_m:.4f}")
    if not measured.pairing.worst_error_s <= PAIRING_S:
        found.append(
            f"the offset of a pair is off by {1e3 * measured.pairing.worst_error_s:.2f} ms, not {1e3 * PAIRING_S}"
        )
    if measured.pairing.mispaired:
        found.append(f"{measured.pairing.mispaired} images are paired with the wrong ToF frame")
    if measured.valid < measured.openings:
        found.append(f"{measured.openings - measured.valid} of the recorded images that count have no valid opening")
    return found


def _frames(peer: str, each: Account) -> list[str]:
    told = f"{each.told_s:.2f} (limit {told_within_s(peer):.2f})"
    numbers = (each.sent, each.recorded, each.in_fault, each.lost)
    return [peer, *map(str, numbers), told, f"{each.back_s:.2f} (limit {BACK_S:.0f})"]


def _stamps(peer: str, each: Account) -> list[str]:
    errors_ms = 1e-6 * np.abs(each.errors_ns)
    stated = f"{1e-6 * each.stated_ns:.3f}"
    return [
        peer,
        f"{np.median(errors_ms):.3f}",
        f"{np.max(errors_ms):.3f}",
        stated,
        str(each.unstated),
        str(len(each.wrong)),
    ]
