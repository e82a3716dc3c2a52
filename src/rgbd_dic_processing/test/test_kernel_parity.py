"""The kernel against its NumPy twin on random images and random warps."""

import numpy as np
import numpy_icgn
import pytest
from rgbd_dic_processing.core.correlation import CorrelationSettings, ReferenceSubsets
from test_kernel import Speckle, homography_seeds, mapped, quantised

SIDE = 150


def random_homography(random: np.random.Generator) -> np.ndarray:
    """Turned by up to 45 degrees, scaled by 0.8 to 1.25, with perspective that changes the scale by 5 % across."""
    angle, scale = np.deg2rad(random.uniform(-45, 45)), np.exp(random.uniform(-1, 1) * np.log(1.25))
    about_middle = np.eye(3)
    about_middle[:2, :2] = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    about_middle[:2, 2] = random.uniform(-5, 5, 2)
    about_middle[2, :2] = random.uniform(-1, 1, 2) * 3e-4
    middle = np.array([[1, 0, SIDE / 2], [0, 1, SIDE / 2], [0, 0, 1]])
    return middle @ about_middle @ np.linalg.inv(middle)


@pytest.mark.parametrize("seed", range(16))
def test_parity_on_random_images_and_warps(seed):
    random = np.random.default_rng(seed)
    settings = CorrelationSettings(
        subset_size=int(random.choice(range(9, 42, 2))),
        spline_degree=(3, 5)[seed % 2],
        gradient_smoothing_px=random.uniform(0, 1),
    )
    h, speckle, noise = random_homography(random), Speckle(seed=100 + seed), random.choice([0, 0.5, 2])
    x, y = np.meshgrid(np.arange(SIDE, dtype=float), np.arange(SIDE, dtype=float))
    speckle.height *= 0.9  # leaves room for the noise
    reference, target = (
        quantised(speckle(*at) + random.normal(0, noise, x.shape)) for at in ((x, y), mapped(np.linalg.inv(h), x, y))
    )
    margin = numpy_icgn.BORDER_PX + settings.subset_size // 2
    centres = random.integers(margin, SIDE - margin, (4, 2))
    seeds = homography_seeds(h, centres)
    seeds[:, :, 0] += random.uniform(-0.4, 0.4, (4, 2))

    subsets = ReferenceSubsets(reference, centres, settings)
    found = subsets.correlate(subsets.target(target), seeds)
    # Those that take longer hardly converge at all, and rounding decides at which step they are near enough.
    comparable = found.valid & (found.iterations <= 10)
    assert comparable.any()
    for k in np.flatnonzero(comparable):
        twin = numpy_icgn.correlate(
            reference,
            target,
            tuple(centres[k]),
            seeds[k],
            subset_size=settings.subset_size,
            degree=settings.spline_degree,
            smoothing_px=settings.gradient_smoothing_px,
        )
        assert found.iterations[k] == twin.iterations
        # Rounding displaces a subset as noise does: in proportion to its uncertainty. 1e-6 px up to 0.05 px.
        limit_px = 1e-6 * max(1, found.sigma_x_px[k] / 0.05, found.sigma_y_px[k] / 0.05)
        assert found.x_px[k] == pytest.approx(twin.x_px, abs=limit_px)
        assert found.y_px[k] == pytest.approx(twin.y_px, abs=limit_px)
