"""How the panel of the laboratory deforms: exact displacement fields with a crack, behind one interface.

Panel frame: origin in the panel's middle, on the crack; x to the right, y down, z into the wall. The crack runs along
x = 0 over the whole height, so that the two sides are separate bodies, each with a smooth field. `side` is -1 left of
the crack and 1 right of it. Every field is proportional to the stroke q of the piston [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..settings import Settings, setting

Array = NDArray[np.float64]
Displacement = tuple[Array, Array, Array]


@dataclass(frozen=True)
class DeformationSettings(Settings):
    """How the panel bends and the crack opens."""

    field: str = setting(
        "beam",
        doc="beam: in-plane three-point bending; plate: plane stress, unlike sides; rigid_half: the left half does not "
        "deform; kirchhoff: a plate that bends out of its plane",
        choices=("beam", "plate", "rigid_half", "kirchhoff"),
    )
    crushed: float = setting(
        1 / 3, low=0.0, high=1.0, doc="part of the stroke that dents the foam at the piston and the supports"
    )
    hinge_share: float = setting(
        0.3, low=0.0, high=1.0, doc="part of the rest that the crack takes up as a hinge; what remains bends the halves"
    )
    slip: float = setting(0.06, low=-1.0, high=1.0, doc="sliding of the crack as a part of the bending stroke")
    poisson: float = setting(0.3, low=-1.0, high=0.5, doc="Poisson's ratio")
    thickness_m: float = setting(0.1, unit="m", low=0.0, high=1.0, doc="of the panel; counts for kirchhoff alone")
    bulge: float = setting(0.12, low=-1.0, high=1.0, doc="shift of the middle towards the camera as a part of it")
    step: float = setting(
        0.005,
        low=-1.0,
        high=1.0,
        doc="out-of-plane step across the crack as a part of it; a slanting view takes it for opening",
    )
    bow_m: float = setting(
        0.0008, unit="m", low=-0.1, high=0.1, doc="shape before any load: how far the ends are behind the middle"
    )


class DeformationField(Protocol):
    """Displacement of material since the unloaded state. Any object with this method can be the laboratory's."""

    def displacement(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int) -> Displacement:
        """dx, dy, dz [m] at material coordinates [m]; smooth on either side, and beyond the crack as its continuation.

        Args:
            stroke_m: q, the part of the piston's stroke that bends the panel.
            side: -1 or 1, a number or an array of the shape of x_m.
        """


class ThreePointBending:
    """A beam on supports at both ends, pressed down in the middle: Euler-Bernoulli, with a hinge at the crack.

    With xi = |x| / L, the deflection (down) of a simple beam of length L under a central load, scaled to delta in the
    middle, is w_e = delta (1 - 6 xi^2 + 4 xi^3) [Gere and Timoshenko, Mechanics of Materials, table of simple beams,
    w = P s (3 L^2 - 4 s^2) / (48 E I) with s = L/2 - |x|]. The crack is a hinge at the top edge y_h = -h/2, where the
    halves touch under the piston; it lets them turn against each other by phi and adds w_h = phi L/4 (1 - 2 xi)
    [a cracked section as a rotational spring: Dimarogonas, Engineering Fracture Mechanics 55 (1996) 831]. The stroke
    is delta + phi L/4. A slip k q of the crack faces turns the whole panel, as its ends stay on the supports.
    Sections stay plane: dx = -y w_e' - (y - y_h) (w_h' + w_s'), dy = w. On each half w'''' = 0, and the moment is zero
    at the ends.

    The jump at the crack is phi (y - y_h) in dx and k q in dy; the strain is -y w_e''.
    """

    def __init__(self, settings: DeformationSettings, width_m: float, height_m: float) -> None:
        self._s, self._length, self.hinge_m = settings, width_m, -height_m / 2

    def turn_rad(self, stroke_m: float) -> float:
        """phi, the angle between the halves."""
        return 4 * self._s.hinge_share * stroke_m / self._length

    def displacement(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int) -> Displacement:
        L, bending, hinge = self._length, (1 - self._s.hinge_share) * stroke_m, self._s.hinge_share * stroke_m
        slip, xi = self._s.slip * stroke_m, side * x_m / L
        w = bending * (1 - 6 * xi**2 + 4 * xi**3) + (hinge + 0.5 * side * slip) * (1 - 2 * xi)
        dx = y_m * side * bending * 12 * (xi - xi**2) / L + (y_m - self.hinge_m) * (2 * side * hinge + slip) / L
        return dx, w, np.zeros_like(w)


class PlaneStressPlate:
    """Two halves in plane stress, each bent by a moment of its own and stretched, that part and turn.

    Pure bending and tension, dx = kappa x y + e x, dy = -kappa (x^2 + nu y^2) / 2 - nu e y [Timoshenko and Goodier,
    Theory of Elasticity, article 21], which satisfies equilibrium exactly, plus a rigid motion of each half. The right
    half bends twice as much as the left one, so the crack's faces curve differently: the sliding is quadratic in y.
    """

    def __init__(self, settings: DeformationSettings, width_m: float, height_m: float) -> None:
        self._s, self._length, self._height = settings, width_m, height_m

    def displacement(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int) -> Displacement:
        nu, q, L = self._s.poisson, stroke_m, self._length
        curvature = (4.0 + 4.0 / 3.0 * side) * (1 - self._s.hinge_share) * q / L**2
        stretch = 0.05 * q / L
        turn = 2 * self._s.hinge_share * q / L * side
        parting, slip = turn * self._height / 2, 0.5 * side * self._s.slip * q
        dx = curvature * x_m * y_m + stretch * x_m + turn * y_m + parting
        dy = -0.5 * curvature * (x_m**2 + nu * y_m**2) - nu * stretch * y_m - turn * x_m + slip
        return dx, dy, np.zeros_like(dx)


class RigidHalf:
    """The left half stays as it is; the right one moves away, turns, and bends as a cantilever with an end load.

    With p = P/(E I) and c = h/2: dx = -p x^2 y / 2 + p (2 + nu) y^3 / 6, dy = nu p x y^2 / 2 + p x^3 / 6 -
    (1 + nu) p c^2 x [Timoshenko and Goodier, Theory of Elasticity, article 21], the exact plane-stress field whose
    shear stress vanishes at the upper and lower edge.
    """

    def __init__(self, settings: DeformationSettings, width_m: float, height_m: float) -> None:
        self._s, self._length, self._height = settings, width_m, height_m

    def displacement(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int) -> Displacement:
        s, q, L, c = self._s, stroke_m, self._length, self._height / 2
        p, turn = 6 * (1 - s.hinge_share) * q / L**3, 4 * s.hinge_share * q / L
        dx = -0.5 * p * x_m**2 * y_m + p * (2 + s.poisson) * y_m**3 / 6 + turn * (y_m + c)
        dy = 0.5 * s.poisson * p * x_m * y_m**2 + p * x_m**3 / 6 - (1 + s.poisson) * p * c**2 * x_m - turn * x_m
        moving = np.where(np.asarray(side) > 0, 1.0, 0.0)
        return moving * dx, moving * (dy + s.slip * q), np.zeros_like(moving * dx)


class KirchhoffPlate:
    """A plate on supports at both ends, pressed towards the camera from behind; the camera sees the stretched face.

    Deflection out of the plane W = -(w - nu w'' y^2 / 2), where w is that of `ThreePointBending` in x: on each half
    biharmonic, with M_y = 0 everywhere [Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, article 10].
    Normals stay normal to the middle plane, so the face at -t/2 moves by (t/2) grad W. The hinge is at the other face,
    so that the crack opens by phi t, evenly along its length.
    """

    def __init__(self, settings: DeformationSettings, width_m: float, height_m: float) -> None:
        self._s, self._length = settings, width_m

    def displacement(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int) -> Displacement:
        s, L, half = self._s, self._length, self._s.thickness_m / 2
        bending, hinge, xi = (1 - s.hinge_share) * stroke_m, s.hinge_share * stroke_m, side * x_m / L
        bent = bending * (1 - 6 * xi**2 + 4 * xi**3)
        slope = side * bending * (-12 * xi + 12 * xi**2) / L
        second, third = bending * (-12 + 24 * xi) / L**2, side * bending * 24 / L**3
        saddle = 0.5 * s.poisson * y_m**2
        dx = -half * (slope - saddle * third) + s.thickness_m * 2 * side * hinge / L
        dy = half * s.poisson * second * y_m + 0.5 * side * s.slip * stroke_m
        return dx, dy, -(bent - saddle * second + hinge * (1 - 2 * xi))


_FIELDS = {
    "beam": ThreePointBending,
    "plate": PlaneStressPlate,
    "rigid_half": RigidHalf,
    "kirchhoff": KirchhoffPlate,
}


class Deformation:
    """A field, a bulge and a step out of the plane, and the panel's shape before any load.

    Args:
        field: another field than the one that the settings name.
    """

    def __init__(
        self, settings: DeformationSettings, width_m: float, height_m: float, field: DeformationField | None = None
    ) -> None:
        self.settings = settings
        self.field = field or _FIELDS[settings.field](settings, width_m, height_m)
        self._half_width, self._half_height = width_m / 2, height_m / 2
        self._left_is_rigid = field is None and settings.field == "rigid_half"

    def shape(self, x_m: Array, y_m: Array) -> Array:
        """z of the unloaded panel [m]: quadratic, 0 in the middle."""
        return self.settings.bow_m * ((x_m / self._half_width) ** 2 + 0.25 * (y_m / self._half_height) ** 2)

    def displacement(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int | None = None) -> Array:
        """(..., 3) [m] of material since the unloaded state; without a side, that of the sign of x_m.

        Args:
            stroke_m: of the piston.
        """
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        at = np.where(x < 0, -1, 1) if side is None else side
        s = self.settings
        q = (1 - s.crushed) * stroke_m
        dx, dy, dz = self.field.displacement(x, y, q, at)
        if self._left_is_rigid:
            dz = dz + np.where(np.asarray(at) > 0, s.step * q, 0.0)
        else:
            dz = dz - s.bulge * q * (1 - (x / self._half_width) ** 2) + 0.5 * at * s.step * q
        return np.stack([dx, dy, dz], axis=-1)

    def jump(self, y_m: Array, stroke_m: float) -> Array:
        """(..., 3) [m]: opening, sliding and step of the crack at y, right face minus left face."""
        y = np.asarray(y_m, float)
        right, left = (self.displacement(np.zeros_like(y), y, stroke_m, side) for side in (1, -1))
        return right - left
