"""ROS parameters made from the dataclasses of settings, so that both have one description."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from ..errors import SettingsError
from ..settings import Settings

S = TypeVar("S", bound=Settings)


def declare(node: Node, settings_class: type[S], prefix: str = "") -> S:
    """Declare one parameter for each field (`prefix.field` if a prefix is given) and return the settings.

    A field that is a group of settings itself becomes `prefix.field.its_field`. The parameters are read-only:
    what a node does is fixed when it starts.

    Raises:
        SettingsError: if a value that the node was started with is refused.
    """
    groups = {
        field.name: declare(node, type(field.default), f"{prefix}.{field.name}".lstrip("."))
        for field in dataclasses.fields(settings_class)
        if isinstance(field.default, Settings)
    }
    fields = [field for field in dataclasses.fields(settings_class) if field.name not in groups]
    names = {field.name: f"{prefix}.{field.name}" if prefix else field.name for field in fields}
    values = {field.name: _started_with(node, names[field.name], field.default) for field in fields}
    try:
        settings = settings_class(**groups, **values)
    except SettingsError as error:
        raise SettingsError(f"parameter of {node.get_fully_qualified_name()}: {error}") from error
    for field in fields:
        value = values[field.name]
        node.declare_parameter(
            names[field.name],
            list(value) if isinstance(value, tuple) else value,
            _descriptor(field),
            ignore_override=True,
        )
    return settings


def declare_path(node: Node, name: str, doc: str, required: bool = True) -> Path | None:
    """Declare a parameter that names a file or folder; None if it is empty and not required.

    Raises:
        SettingsError: if it is required and missing.
    """
    value = _started_with(node, name, "")
    if not isinstance(value, str):
        raise SettingsError(f"parameter {name} = {value!r}: expected a path")
    if not value and required:
        raise SettingsError(f"parameter {name} is missing: {doc}. Give it with --ros-args -p {name}:=PATH")
    descriptor = ParameterDescriptor(description=doc, read_only=True)
    node.declare_parameter(name, value, descriptor, ignore_override=True)
    return Path(value).expanduser() if value else None


def _started_with(node: Node, name: str, default: Any) -> Any:
    """The value from the command line or parameter file, of whatever type, or the default."""
    start = list(default) if isinstance(default, tuple) else default
    value = node.declare_parameter(name, start, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(name)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(default, tuple) and (value is None or isinstance(value, list)):
        return tuple(value or ())  # an empty list arrives as no value
    return value


def _descriptor(field: dataclasses.Field) -> ParameterDescriptor:
    meta = field.metadata
    unit = f" [{meta['unit']}]" if meta.get("unit") else ""
    choices = f"; one of {', '.join(meta['choices'])}" if meta.get("choices") else ""
    low, high = meta.get("low"), meta.get("high")
    descriptor = ParameterDescriptor(description=f"{meta.get('doc', '')}{unit}{choices}", read_only=True)
    if low is None or high is None:
        return descriptor
    if isinstance(field.default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif isinstance(field.default, int) and not isinstance(field.default, bool):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor
