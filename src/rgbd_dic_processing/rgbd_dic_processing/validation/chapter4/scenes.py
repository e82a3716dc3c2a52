"""The laboratories that are measured."""

from __future__ import annotations

import functools
import json
from typing import Any

from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings

Values = dict[str, Any]  # what differs from the preset `laboratory`, by group


def laboratory_values(field: str, seed: int, duration_s: float, scale: float = 1.0) -> Values:
    """A deformation field and a seed. scale: of the images."""
    return {"seed": seed, "duration_s": duration_s, "camera": {"scale": scale}, "deformation": {"field": field}}


def open_laboratory(values: Values) -> Laboratory:
    """The laboratory with these settings; the last one stays open."""
    return _open(json.dumps(values, sort_keys=True))


@functools.lru_cache(maxsize=1)
def _open(values: str) -> Laboratory:
    return Laboratory(laboratory_settings("laboratory", json.loads(values)))
