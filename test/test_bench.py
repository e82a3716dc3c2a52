"""The benchmark's own truth: the pattern's gradients, the warps, and the Cramer-Rao bound."""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
import pytest
from system import ROOT


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch):
    """Modules of tools/bench by name."""
    monkeypatch.syspath_prepend(str(ROOT / "tools/bench"))
    return importlib.import_module


def small(speckle: ModuleType, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr(speckle, "SIZE", size)
    monkeypatch.setattr(speckle, "MARGIN", 40.0)


def test_gradients_are_derivatives(bench, monkeypatch) -> None:
    speckle = bench("speckle")
    small(speckle, monkeypatch, 60)
    pattern, h = speckle.Speckle(2), 1e-3
    x, y = np.random.default_rng(0).uniform(0, 60, (2, 500))
    _, along_x, along_y = pattern.with_gradient(x, y)
    # A blob that comes within reach between the two points adds 34 exp(-18) = 5e-7 grey levels; over 2 h, 3e-4 / px.
    np.testing.assert_allclose(along_x, (pattern(x + h, y) - pattern(x - h, y)) / (2 * h), atol=5e-4)
    np.testing.assert_allclose(along_y, (pattern(x, y + h) - pattern(x, y - h)) / (2 * h), atol=5e-4)


def test_warp_gradients_are_derivatives(bench) -> None:
    speckle = bench("speckle")
    motion, h = speckle.about_middle("", 10, 1.1, 0.02, (1e-4, -5e-5), (3, 4)), 1e-3
    points = np.random.default_rng(0).uniform(100, 900, (50, 2))
    steps = [(motion(points + h * e) - motion(points - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(motion.gradient(points), np.stack(steps, axis=2), atol=1e-8)


def test_target_is_the_moved_reference(bench, monkeypatch) -> None:
    """A target moved by whole pixels holds the reference's numbers."""
    speckle = bench("speckle")
    small(speckle, monkeypatch, 60)
    pattern = speckle.Speckle(2)
    reference, target = speckle.reference_image(pattern), speckle.target_image(pattern, speckle.shift(3, 5))
    np.testing.assert_allclose(target[5:, 3:], reference[:-5, :-3], atol=1e-6)


def test_bound_is_reached_by_least_squares(bench, monkeypatch) -> None:
    """A linear fit of the six parameters to noise in both images scatters as the bound says (4000 draws: to 1.1 %)."""
    speckle, bound = bench("speckle"), bench("cramer_rao")
    small(speckle, monkeypatch, 60)
    pattern, noise, half = speckle.Speckle(2), 1.0, 15
    texture = bound.Texture(pattern, 60, np.array([[30, 28]]), 2 * half + 1)
    floor = texture.floor_px(speckle.shift(0.3, 0.6), noise)
    y, x = np.mgrid[28 - half : 28 + half + 1, 30 - half : 30 + half + 1].reshape(2, -1).astype(float)
    _, along_x, along_y = pattern.with_gradient(x, y)
    basis = np.stack([np.ones_like(x), x - 30, y - 28], axis=1)
    design = np.hstack([along_x[:, None] * basis, along_y[:, None] * basis])
    variance = noise**2 + bound.QUANTISATION_VARIANCE
    residuals = np.random.default_rng(1).normal(0, np.sqrt(2 * variance), (len(x), 4000))
    fitted = np.linalg.lstsq(design, residuals, rcond=None)[0]
    np.testing.assert_allclose(fitted[[0, 3]].std(axis=1), floor, rtol=0.04)


def test_magnified_target_bounds_less(bench, monkeypatch) -> None:
    """With four target pixels on each of the reference, noise of the target counts a quarter, and a pixel half."""
    speckle, bound = bench("speckle"), bench("cramer_rao")
    small(speckle, monkeypatch, 60)
    texture = bound.Texture(speckle.Speckle(2), 60, np.array([[30, 28]]), 31)
    same, double = (texture.floor_px(speckle.about_middle("", scale=scale), 1.0) for scale in (1.0, 2.0))
    np.testing.assert_allclose(double / same, 2 * np.sqrt((1 + 1 / 4) / 2))
