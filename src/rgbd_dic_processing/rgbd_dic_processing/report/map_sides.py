"""Which subsets belong to the fixed region and which move: their displacements differ in size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.displacement_field import DisplacementField
from ..core.regions import CrackZones, Regions

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Side:
    """members: (N,) the subsets of its map. moves: whether displacement is expected of it, or zero."""

    name: str
    members: Mask
    moves: bool


def sides_of(regions: Regions | None, field: DisplacementField) -> list[Side]:
    """The fixed region and the rest, or all of the panel where nothing is drawn as fixed.

    Where the crack is known, only what lies wholly beyond it is the moving part: a subset that touches the
    crack measures neither side, and one between the crack and the fixed region has no reason to move.
    """
    everything = np.ones(len(field.centres_px), bool)
    if regions is None or not (regions.fixed or regions.fixed_holes):
        return [Side("panel", everything, moves=True)]
    fixed = regions.fixed_members(field.centres_px)
    moving = ~fixed
    if regions.crack is not None and fixed.any():
        beyond = moving & _beyond(regions.crack, field, fixed)
        moving = beyond if beyond.any() else moving
    sides = [Side("fixed region", fixed, moves=False), Side("moving part", moving, moves=True)]
    return [side for side in sides if side.members.any()]


def _beyond(crack: CrackZones, field: DisplacementField, fixed: Mask) -> Mask:
    """(N,) subsets that lie wholly on the other side of the crack's line than most of the fixed region."""
    distance_px, reach_px = _from_crack(crack, field)
    away = -np.sign(np.median(distance_px[fixed]))
    return distance_px * away > reach_px


def on_crack(crack: CrackZones, field: DisplacementField) -> Mask:
    """(N,) subsets that touch the crack's line."""
    distance_px, reach_px = _from_crack(crack, field)
    return np.abs(distance_px) <= reach_px


def _from_crack(crack: CrackZones, field: DisplacementField) -> tuple[NDArray[np.float64], float]:
    """How far the centres (N,) lie from the crack's line, and how far a subset reaches towards it."""
    normal = np.array([crack.direction[1], -crack.direction[0]])
    return (field.centres_px - crack.point) @ normal, field.subset_px / 2 * np.abs(normal).sum()
