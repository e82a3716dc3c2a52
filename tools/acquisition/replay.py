"""The recording through the method, against the truth of the images that the camera showed."""

from __future__ import annotations

import math
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from accounting import Account
from numpy.typing import NDArray
from recorded import MIDDLE_NS
from rendered_flight import RenderedFlight
from rgbd_dic_acquisition.simulator.ground_truth import save_regions
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.results import CSV_NAME, compare, read_openings, read_truth
from session import BAG, Flown

# Half of an opening's variance is the noise of the reference image, which is one draw for the whole flight; the other
# half is drawn anew in each image. If that one draw is three standard deviations off, the RMS is sqrt(9/2 + 1/2).
EXPLAINED = math.sqrt(5.0)
PAIRING_S = 2e-3  # by which the offset of a pair may be off


@dataclass(frozen=True)
class Pairing:
    """Time between the images and their ToF frames.

    Attributes:
        offsets_s: by the stamps, of images that have one.
        unpaired: images that have none.
        worst_error_s: largest difference of an offset to what the peers wrote down.
        mispaired: images with another ToF frame nearer. An offset that is off by some time makes one frame seem so much
            nearer and the other so much farther, so only more than twice that counts.
    """

    offsets_s: NDArray[np.float64]
    unpaired: int
    worst_error_s: float
    mispaired: int


@dataclass(frozen=True)
class Replayed:
    """What the method made of the recording.

    Attributes:
        openings, valid, pairing: of the part that counts.
        range_m: of the truth. rms_m, bound_m: error of all that are valid, and what noise explains.
    """

    openings: int
    valid: int
    range_m: float
    rms_m: float
    bound_m: float
    pairing: Pairing


def replay(
    folder: Path, rendered: RenderedFlight, settings: ProcessingSettings, flown: Flown, camera: Account, tof: Account
) -> Replayed:
    """Run `rgbd-dic process` on the bag, and compare."""
    truth, regions, chosen, out = (folder / name for name in ("truth.csv", "regions.yaml", "settings.yaml", "replayed"))
    opening_m = {stamp: rendered.flight.crack(rendered.image_time_s(k)).opening_m for stamp, k in camera.index.items()}
    rows = [f"{stamp},{1e3 * metres:.9f}" for stamp, metres in opening_m.items()]
    truth.write_text("\n".join(["stamp_ns,opening_mm", *rows]) + "\n")
    chosen.write_text(yaml.safe_dump(settings.as_dict()))
    save_regions(rendered.flight, rendered.image_time_s(camera.index[min(camera.index)]), regions)  # of the first image
    given = {"regions": regions, "calibration": rendered.calibration, "truth": truth, "settings": chosen}
    words = [word for name, path in {**given, "out": out}.items() for word in (f"--{name}", str(path))]
    subprocess.run(["rgbd-dic", "process", str(folder / BAG), *words], check=True)
    openings = read_openings(out / CSV_NAME)
    compared = compare(openings, read_truth(truth))[0]
    valid = [opening for opening in openings if opening.valid]
    stated_m = math.sqrt(np.mean([opening.u_opening_m**2 for opening in valid]))
    range_m = float(np.ptp(list(opening_m.values())))
    count = [opening for opening in openings if flown.begin_ns <= opening.stamp_ns < flown.end_ns]
    valid_of_them, pairing = sum(opening.valid for opening in count), _pairing(count, camera, tof)
    return Replayed(len(count), valid_of_them, range_m, compared.rms_m, EXPLAINED * stated_m, pairing)


def _pairing(openings: list[CrackOpening], camera: Account, tof: Account) -> Pairing:
    tof_stamps = np.array(sorted(tof.true_ns), np.int64)
    tof_moments = np.array([tof.true_ns[int(stamp)] for stamp in tof_stamps], np.int64)
    # of images that belong to no frame that was sent, the account tells
    found = [opening for opening in openings if opening.stamp_ns in camera.true_ns]
    paired = [opening for opening in found if math.isfinite(opening.depth_offset_s)]
    errors, mispaired = [], 0
    for opening in paired:
        exposed_ns = camera.true_ns[opening.stamp_ns] + MIDDLE_NS
        partner = np.argmin(np.abs(opening.stamp_ns - round(1e9 * opening.depth_offset_s) - tof_stamps))
        true_offset_ns = int(exposed_ns - tof_moments[partner])
        errors.append(abs(opening.depth_offset_s - 1e-9 * true_offset_ns))
        mispaired += bool(np.min(np.abs(exposed_ns - tof_moments)) < abs(true_offset_ns) - 2e9 * PAIRING_S)
    offsets = np.array([opening.depth_offset_s for opening in paired])
    return Pairing(offsets, len(found) - len(paired), max(errors), mispaired)
