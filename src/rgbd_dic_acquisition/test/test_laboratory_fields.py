"""The laboratory's deformation fields and its press against the equations that they state."""

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.errors import SettingsError
from rgbd_dic_acquisition.simulator.laboratory import LaboratorySettings, laboratory_settings
from rgbd_dic_acquisition.simulator.laboratory_fields import (
    Deformation,
    DeformationSettings,
    KirchhoffPlate,
    PlaneStressPlate,
    RigidHalf,
    ThreePointBending,
)
from rgbd_dic_acquisition.simulator.laboratory_press import Press, PressSettings

WIDTH, HEIGHT, STROKE = 1.2, 0.6, 0.002
SETTINGS = DeformationSettings(crushed=0.0)
STEP = 0.01  # of the finite differences, which are exact for polynomials of the fourth degree
SIDES = pytest.mark.parametrize("side", [-1, 1])


def inner_points(side):
    rng = np.random.default_rng(7)
    return side * rng.uniform(0.05, 0.55, 40), rng.uniform(-0.25, 0.25, 40)


def first(f, x, y, axis):
    """df/dx or df/dy by the five-point rule."""
    h = STEP * np.eye(2)[axis]
    at = [f(x + k * h[0], y + k * h[1]) for k in (-2, -1, 1, 2)]
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * STEP)


def strains(field, side):
    def component(i):
        return lambda x, y: field.displacement(x, y, STROKE, side)[i]

    return (
        lambda x, y: first(component(0), x, y, 0),
        lambda x, y: first(component(1), x, y, 1),
        lambda x, y: first(component(0), x, y, 1) + first(component(1), x, y, 0),
    )


@SIDES
def test_beam_is_euler_bernoulli_on_two_supports(side):
    field = ThreePointBending(SETTINGS, WIDTH, HEIGHT)
    x, y = inner_points(side)
    along_x, along_y, shear = (strain(x, y) for strain in strains(field, side))
    np.testing.assert_allclose(shear, 0, atol=1e-12)  # plane sections stay square to the axis
    np.testing.assert_allclose(along_y, 0, atol=1e-12)

    def deflection(position):
        return field.displacement(position, np.zeros_like(position), STROKE, side)[1]

    def second(position):
        return (deflection(position + STEP) - 2 * deflection(position) + deflection(position - STEP)) / STEP**2

    np.testing.assert_allclose(along_x, -y * second(x), atol=1e-11)
    fourth = second(x + STEP) - 2 * second(x) + second(x - STEP)
    np.testing.assert_allclose(fourth, 0, atol=1e-11)  # no load between the supports and the piston
    end = np.array([side * WIDTH / 2])
    assert deflection(end) == pytest.approx(0, abs=1e-15) and second(end) == pytest.approx(0, abs=1e-10)
    largest_moment = 12 * (1 - SETTINGS.hinge_share) * STROKE / WIDTH**2
    assert second(np.array([side * 1e-9])) == pytest.approx(-largest_moment, rel=1e-2)


def test_beam_goes_down_by_the_stroke_and_opens_as_a_hinge():
    field = ThreePointBending(SETTINGS, WIDTH, HEIGHT)
    deformation = Deformation(SETTINGS, WIDTH, HEIGHT)
    faces = [field.displacement(np.zeros(1), np.zeros(1), STROKE, side)[1] for side in (-1, 1)]
    assert np.mean(faces) == pytest.approx(STROKE)
    y = np.linspace(-HEIGHT / 2, HEIGHT / 2, 7)
    jump = deformation.jump(y, STROKE)
    np.testing.assert_allclose(jump[:, 0], field.turn_rad(STROKE) * (y + HEIGHT / 2), atol=1e-15)
    np.testing.assert_allclose(jump[:, 1:], STROKE * np.array([[SETTINGS.slip, SETTINGS.step]]) * np.ones((7, 1)))
    assert jump[-1, 0] == pytest.approx(4 * SETTINGS.hinge_share * STROKE / WIDTH * HEIGHT)


@SIDES
@pytest.mark.parametrize("kind", [PlaneStressPlate, RigidHalf])
def test_plane_stress_is_in_equilibrium(kind, side):
    """d sigma_x/dx + d tau/dy = 0 and d tau/dx + d sigma_y/dy = 0, with E = 1."""
    nu = SETTINGS.poisson
    along_x, along_y, shear = strains(kind(SETTINGS, WIDTH, HEIGHT), side)

    def sigma_x(x, y):
        return (along_x(x, y) + nu * along_y(x, y)) / (1 - nu**2)

    def sigma_y(x, y):
        return (along_y(x, y) + nu * along_x(x, y)) / (1 - nu**2)

    def tau(x, y):
        return shear(x, y) / (2 * (1 + nu))

    x, y = inner_points(side)
    np.testing.assert_allclose(first(sigma_x, x, y, 0) + first(tau, x, y, 1), 0, atol=1e-11)
    np.testing.assert_allclose(first(tau, x, y, 0) + first(sigma_y, x, y, 1), 0, atol=1e-11)
    if kind is RigidHalf and side > 0:
        np.testing.assert_allclose(tau(x, np.full_like(x, HEIGHT / 2)), 0, atol=1e-12)
        assert np.abs(along_x(x, y)).max() > 1e-4


def test_half_is_rigid_where_it_is_said_to_be():
    deformation = Deformation(replace(SETTINGS, field="rigid_half"), WIDTH, HEIGHT)
    x, y = inner_points(-1)
    assert np.all(deformation.displacement(x, y, STROKE) == 0)
    assert np.all(np.abs(deformation.displacement(-x, y, STROKE)).max(axis=0) > [5e-5, 5e-5, 5e-6])


@SIDES
def test_kirchhoff_plate_is_biharmonic_with_free_edges(side):
    field = KirchhoffPlate(SETTINGS, WIDTH, HEIGHT)

    def w(x, y):
        return field.displacement(x, y, STROKE, side)[2]

    def second(f, axis):
        return lambda x, y: first(lambda a, b: first(f, a, b, axis), x, y, axis)

    x, y = inner_points(side)
    x = np.clip(np.abs(x), 0.1, 0.5) * side
    wxx, wyy = second(w, 0), second(w, 1)
    np.testing.assert_allclose(wyy(x, y) + SETTINGS.poisson * wxx(x, y), 0, atol=1e-11)  # M_y
    biharmonic = second(wxx, 0)(x, y) + 2 * second(wxx, 1)(x, y) + second(wyy, 1)(x, y)
    np.testing.assert_allclose(biharmonic, 0, atol=1e-8)
    dx, dy, _ = field.displacement(x, y, STROKE, side)
    turn = 2 * SETTINGS.hinge_share * STROKE / WIDTH
    half = SETTINGS.thickness_m / 2
    np.testing.assert_allclose(dx, half * (first(w, x, y, 0) + side * turn), atol=1e-15)  # about the far face
    np.testing.assert_allclose(dy - 0.5 * side * SETTINGS.slip * STROKE, half * first(w, x, y, 1), atol=1e-15)


@pytest.mark.parametrize("name", ["beam", "plate", "rigid_half", "kirchhoff"])
def test_fields_are_linear_in_the_stroke_and_unlike_at_the_crack_only(name):
    deformation = Deformation(replace(SETTINGS, field=name), WIDTH, HEIGHT)
    x, y = (np.concatenate(v) for v in zip(inner_points(-1), inner_points(1), strict=True))
    full, none = (deformation.displacement(x, y, stroke) for stroke in (STROKE, 0.0))
    assert np.all(none == 0)
    np.testing.assert_allclose(deformation.displacement(x, y, STROKE / 3), full / 3, atol=1e-16)
    just = deformation.displacement(np.array([-1e-12, 1e-12]), np.full(2, 0.1), STROKE)
    np.testing.assert_allclose(just[1] - just[0], deformation.jump(np.array(0.1), STROKE), atol=1e-13)
    assert deformation.shape(np.array(WIDTH / 2), np.array(0.0)) == pytest.approx(SETTINGS.bow_m)


def test_what_is_crushed_does_not_bend():
    whole, part = (Deformation(replace(SETTINGS, crushed=c), WIDTH, HEIGHT) for c in (0.0, 0.25))
    x, y = inner_points(1)
    np.testing.assert_allclose(part.displacement(x, y, 0.004), whole.displacement(x, y, 0.003), atol=1e-16)


def test_press_does_not_follow_its_sinusoid():
    settings = PressSettings()
    press = Press(settings, 10.0)
    time = np.arange(0, 10, 0.01)
    stroke, command = press.stroke(time), press.command(time)
    assert np.all(stroke[time <= settings.still_s] == 0) and np.all(stroke > -1e-9)
    cycle = time > 2.5
    assert 0.0025 < np.ptp(stroke[cycle]) < settings.clip * settings.stroke_m
    spectrum = np.abs(np.fft.rfft(stroke[200:] - stroke[200:].mean()))
    frequency = np.fft.rfftfreq(len(stroke[200:]), 0.01)
    assert frequency[np.argmax(spectrum)] == pytest.approx(0.5)
    assert spectrum[np.isclose(frequency, 1.0)] > 0.02 * spectrum.max()  # not a sinusoid
    lag = np.arange(0, 0.5, 0.01)
    fits = [np.corrcoef(np.interp(time - shift, time, command)[cycle], stroke[cycle])[0, 1] for shift in lag]
    assert 0.05 < lag[np.argmax(fits)] < 0.3
    speed = np.gradient(stroke, 0.01)
    assert np.abs(speed).max() <= settings.speed_m_s * 1.001
    assert np.mean(np.abs(speed[cycle]) < 1e-4) > 0.1  # it dwells


def test_presets_take_what_differs_from_them():
    hard = laboratory_settings("laboratory_hard", {"orbit": {"roll_rad": 0.1}, "seed": 4})
    assert (hard.orbit.roll_rad, hard.orbit.yaw_rad, hard.seed, hard.motion.distance_m) == (0.1, 0.26, 4, 2.5)
    assert laboratory_settings() == LaboratorySettings()
    with pytest.raises(SettingsError, match=r"flight.yaml.press: unknown setting force"):
        laboratory_settings("laboratory", {"press": {"force": 1.0}}, "flight.yaml")
    with pytest.raises(SettingsError, match="choose one of beam, plate, rigid_half, kirchhoff"):
        laboratory_settings("laboratory", {"deformation": {"field": "rope"}})
