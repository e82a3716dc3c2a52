"""The DIC on images of the simulated laboratory: where the subsets went, against the laboratory's truth."""

import numpy as np
import pytest
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_processing.cli import main
from rgbd_dic_processing.core.correlation import CorrelationSettings
from rgbd_dic_processing.core.regions import CrackZones, Regions
from rgbd_dic_processing.core.settings import RenewalSettings, SearchSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.tracking import SubsetTracking

BESIDE_M = 0.035  # from the crack to the middle of a subset that holds nothing of it
SHARP = {"scale": 0.5, "exposure_s": 0.0}
CLEAN = {"noise": False, "flicker": 0.0, "vignetting": 0.0, "lamp_gradient": 0.0}


def errors(times_s, settings, **groups):
    """Of all subsets beside the crack at some times (T, N, 2): found minus true [px]; the sigmas; and on which side."""
    lab = Laboratory(laboratory_settings(values={"tof": {"scale": 0.1}, **groups}))
    crack = lab.regions["crack"]
    zones = CrackZones.from_point(np.array(crack["point"]), np.array(crack["direction"]), *crack["size"], crack["gap"])
    regions = Regions(np.array(lab.regions["panel"]), (), None, zones)
    still = RenewalSettings(after_frames=0)
    tracking = SubsetTracking(lab.calibration.camera, regions, settings, SearchSettings(), still)
    assert tracking.track(0, lab.image(lab.reference_s, 0)).status == FrameStatus.OK
    material = lab.material(tracking.reference.centres_px, lab.reference_s)
    beside = np.abs(material[:, 0]) > BESIDE_M
    fields = [tracking.track(i, lab.image(t, i)) for i, t in enumerate(times_s, start=1)]
    truth = np.array([lab.project(*material[beside].T, t) for t in times_s])
    found, sigma = (np.array([getattr(f, name)[beside] for f in fields]) for name in ("moved_px", "sigma_px"))
    return found - truth, sigma, np.sign(material[beside, 0])


@pytest.mark.parametrize("field", ["beam", "plate", "rigid_half", "kirchhoff"])
def test_subsets_are_found_within_their_sigma(field):
    """Photon, read and fixed-pattern noise, shading and flicker; sharp images, as a blurred one is off its pattern.

    The RMS of error over sigma is 1 if sigma is right; of some 2 x 900 overlapping subsets in two directions it is
    known to a few parts in a hundred, and the noise of the one reference is common to both frames.
    """
    error, sigma, _ = errors((0.9, 1.3), CorrelationSettings(step=12), camera=SHARP, deformation={"field": field})
    assert np.isfinite(error).all() and error.shape[1] > 900
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.004


def test_images_without_noise_show_the_truth():
    """Of 8-bit images nothing but rounding is left: some 0.001 px a subset, and no bias on either half. Subsets of the
    second order, as those of the first read some 0.002 px of the bending as a shift."""
    settings = CorrelationSettings(step=12, increment_order=2)
    error, _, side = errors((1.3,), settings, camera={**SHARP, **CLEAN})
    for half in (side < 0, side > 0):
        assert np.abs(error[0, half].mean(axis=0)).max() < 2e-4
    assert error.std() < 0.0015


@pytest.mark.parametrize("preset", ["laboratory", "laboratory_hard"])
def test_simulate_makes_a_bag_of_it(preset, tmp_path, capsys):
    (tmp_path / "small.yaml").write_text("camera: {scale: 0.1}\ntof: {scale: 0.1}\n")
    options = ["--preset", preset, "--settings", str(tmp_path / "small.yaml"), "--duration", "0.2", "--seed", "3"]
    assert main(["simulate", *options, "--out", str(tmp_path / "bag")]) == 0
    assert "/camera/image_raw" in capsys.readouterr().out
    assert (tmp_path / "bag" / "reference_3d_dic.csv").exists()
    (tmp_path / "small.yaml").write_text("camera: {zoom: 2}\n")
    assert main(["simulate", *options, "--out", str(tmp_path / "other")]) == 1
