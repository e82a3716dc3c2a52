"""Settings: one frozen dataclass a stage, each field with unit, range and a sentence.

The offline tool's YAML, the nodes' ROS parameters and the tables in docs/parameters.md are all made from
these fields, so that a value means the same everywhere.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, TypeVar

from .errors import SettingsError

S = TypeVar("S", bound="Settings")


def setting(
    default: Any,
    *,
    doc: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A dataclass field with what a reader and a range check need to know about it."""
    metadata = {"doc": doc, "unit": unit, "low": low, "high": high, "choices": choices}
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Base of all settings: checks type and range of every field when made.

    Raises:
        SettingsError: naming the field, the value and what is allowed.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            _check(type(self).__name__, field, getattr(self, field.name))

    @classmethod
    def from_mapping(cls: type[S], values: Mapping[str, Any], where: str = "settings") -> S:
        """From a mapping of field names to values, such as a group of a YAML file; the rest keeps its default.

        A field that is a group of settings itself takes a mapping of its own.
        """
        return cls._with({}, values, where)

    def updated(self: S, values: Mapping[str, Any], where: str = "settings") -> S:
        """These settings with what a mapping, as `from_mapping` takes it, says otherwise."""
        fields = dataclasses.fields(self)
        return self._with({field.name: getattr(self, field.name) for field in fields}, values, where)

    @classmethod
    def _with(cls: type[S], kept: Mapping[str, Any], values: Mapping[str, Any], where: str) -> S:
        if not isinstance(values, Mapping):
            raise SettingsError(f"{where}: expected a mapping of names to values, got {values!r}")
        fields = {field.name: field for field in dataclasses.fields(cls)}
        unknown = sorted(set(values) - set(fields))
        if unknown:
            raise SettingsError(f"{where}: unknown setting {', '.join(unknown)}; known are {', '.join(sorted(fields))}")
        parsed = {**kept, **values}
        for name, value in values.items():
            group = kept.get(name, fields[name].default)
            if isinstance(group, Settings) and not isinstance(value, Settings):
                parsed[name] = group.updated(value, f"{where}.{name}")
        return cls(**parsed)

    def as_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


def _check(owner: str, field: dataclasses.Field, value: Any) -> None:
    kind, meta = type(field.default), field.metadata
    name = f"{owner}.{field.name}"
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise SettingsError(f"{name} = {value!r}: expected {kind.__name__}, such as {field.default!r}")
    unit = f" {meta['unit']}" if meta.get("unit") else ""
    if meta.get("choices") and value not in meta["choices"]:
        raise SettingsError(f"{name} = {value!r}: choose one of {', '.join(meta['choices'])}")
    if kind is float and not math.isfinite(value):
        raise SettingsError(f"{name} = {value!r}: must be a finite number")
    low, high = meta.get("low"), meta.get("high")
    if (low is not None and value < low) or (high is not None and value > high):
        allowed = " and ".join(
            text
            for text in (
                f"at least {low:g}{unit}" if low is not None else "",
                f"at most {high:g}{unit}" if high is not None else "",
            )
            if text
        )
        raise SettingsError(f"{name} = {value!r}{unit} is out of range: must be {allowed}")
