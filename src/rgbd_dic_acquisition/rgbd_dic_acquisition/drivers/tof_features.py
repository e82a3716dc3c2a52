"""The features of an open device by their GenICam names, whichever library reads them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import DeviceError, SettingsError


@dataclass(frozen=True)
class Features:
    """The features of an open device.

    Attributes:
        find: the node of a name; None or an error if there is none.
        errors: what the library raises ...
        refusals: ... for a value that a feature cannot have ...
        denied: ... and for a feature that cannot be written now.
        attribute: how the library spells the attributes of a node: "value" -> "value" or "Value".
    """

    find: Callable[[str], Any]
    errors: tuple[type[Exception], ...]
    refusals: tuple[type[Exception], ...]
    denied: type[Exception]
    attribute: Callable[[str], str]

    def get(self, name: str) -> Any:
        """The value, or None if the device has no such feature or does not tell."""
        return self._read(name, "value")

    def set(self, name: str, value: Any) -> bool:
        """Set it; whether the device has it.

        Raises:
            SettingsError: it has, but refuses the value.
            DeviceError: it does not answer.
        """
        present = self.get(name)
        if present is None:
            return False
        try:
            setattr(self.find(name), self.attribute("value"), value)
        except self.errors as error:
            if present == value and isinstance(error, self.denied):
                return True
            told = str(error).strip().splitlines()
            kind = SettingsError if isinstance(error, self.refusals) else DeviceError
            raise kind(
                f"the device refuses {name} = {value}{self._allowed(name)}: {told[0] if told else error!r}"
            ) from error
        return True

    def execute(self, name: str) -> None:
        """Give a command; not answered if the device lacks it."""
        with contextlib.suppress(*self.errors, AttributeError):
            getattr(self.find(name), self.attribute("execute"))()

    def choices(self, name: str) -> tuple[str, ...]:
        """What an enumeration can be set to now."""
        return tuple(self._read(name, "symbolics") or ())

    def _allowed(self, name: str) -> str:
        if choices := self.choices(name):
            return f" (possible: {', '.join(choices)})"
        low, high = self._read(name, "min"), self._read(name, "max")
        return "" if low is None or high is None else f" (possible: {low:g} to {high:g})"

    def _read(self, name: str, attribute: str) -> Any:
        try:
            return getattr(self.find(name), self.attribute(attribute), None)
        except self.errors:
            return None
