"""Making ROS messages from names and arrays, and the qualities of service that the nodes share."""

from __future__ import annotations

import array
import importlib
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ..errors import RgbdDicError
from ..settings import Settings, setting

# Element types of message sequences: the type code of array.array and the NumPy type.
_ELEMENTS = {
    "uint8": ("B", np.uint8),
    "int8": ("b", np.int8),
    "uint16": ("H", np.uint16),
    "int16": ("h", np.int16),
    "uint32": ("I", np.uint32),
    "int32": ("i", np.int32),
    "uint64": ("Q", np.uint64),
    "int64": ("q", np.int64),
    "float": ("f", np.float32),
    "double": ("d", np.float64),
}


DETAILS = 10  # times as many small messages are kept as frames


@dataclass(frozen=True)
class QosSettings(Settings):
    """How a sensor's frames are sent."""

    reliability: str = setting(
        "reliable",
        doc="whether lost frames are sent again; best_effort never waits for a slow receiver",
        choices=("reliable", "best_effort"),
    )
    depth: int = setting(
        10,
        doc="frames kept for receivers that lag behind; ten times as many of what is small",
        unit="frames",
        low=1,
        high=1000,
    )


def image_qos(settings: QosSettings) -> QoSProfile:
    """For images and depth frames."""
    return _frame_qos(settings, settings.depth)


def detail_qos(settings: QosSettings) -> QoSProfile:
    """For what comes with each of them, or more often, and is small: it must not be lost where a machine that halted
    makes up for it by a burst of frames."""
    return _frame_qos(settings, DETAILS * settings.depth)


def _frame_qos(settings: QosSettings, depth: int) -> QoSProfile:
    reliable = settings.reliability == "reliable"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def latched_qos(depth: int = 1) -> QoSProfile:
    """For what is sent once and must reach who comes later: the reference, static transforms."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


@cache
def message_class(typename: str) -> type:
    """The class of a type such as "sensor_msgs/msg/Image".

    Raises:
        RgbdDicError: if it is not such a name, or its package is not installed.
    """
    package, _, name = typename.replace("/msg/", "/").partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise RgbdDicError(
            f"message type '{typename}' is not available here ({error}): install the package '{package}'"
        ) from error


def make(typename: str, **fields: Any) -> Any:
    """A message of the named type with these fields; arrays may be ndarrays of any numeric type."""
    cls, types = message_class(typename), _field_types(typename)
    return cls(**{name: _field(types.get(name, ""), value) for name, value in fields.items()})


@cache
def _field_types(typename: str) -> dict[str, str]:
    return message_class(typename).get_fields_and_field_types()  # makes a copy each time


def _field(kind: str, value: Any) -> Any:
    if type(value) is float:
        return value
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, np.ndarray):
        return value
    element = kind.removeprefix("sequence<").split("[")[0].split(">")[0].split(",")[0]
    if element not in _ELEMENTS:
        return value.ravel().tolist()
    code, dtype = _ELEMENTS[element]
    flat = np.ascontiguousarray(value, dtype=dtype).ravel()
    if not kind.startswith("sequence<"):
        return flat
    # rclpy takes an array.array as it is, but visits every element of an ndarray.
    elements = array.array(code)
    elements.frombytes(memoryview(flat).cast("B"))
    return elements
