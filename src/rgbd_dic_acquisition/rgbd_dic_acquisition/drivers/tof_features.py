"""The features of an open device by their GenICam names, whichever library reads them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import DeviceError, SettingsError


@dataclass(frozen=True)
class Features:
    """The features of an open device. Every method raises DeviceError if the device does not answer.

    Attributes:
        find: the node of a name, or one of the errors.
        genapi: the library's module of GenApi, for its kinds of errors.
        errors: everything that the library raises.
        attribute: how the library spells the attributes of a node: "value" -> "value" or "Value".
    """

    find: Callable[[str], Any]
    genapi: Any
    errors: tuple[type[Exception], ...]
    attribute: Callable[[str], str]

    def get(self, name: str) -> Any:
        """The value, or None if the device has no such feature, or not now."""
        return self._read(name, "value")

    def set(self, name: str, value: Any) -> bool:
        """Set it; whether the device has it.

        Raises:
            SettingsError: it has, but refuses the value.
        """
        present = self.get(name)
        if present is None:
            return False
        try:
            setattr(self.find(name), self.attribute("value"), value)
        except self.errors as error:
            if present == value and isinstance(error, self.genapi.AccessException):
                return True  # it is fixed at that
            refused = isinstance(error, (self.genapi.OutOfRangeException, self.genapi.InvalidArgumentException))
            kind = SettingsError if refused else DeviceError
            raise kind(f"the device refuses {name} = {value}{self._allowed(name)}: {_first_line(error)}") from error
        return True

    def execute(self, name: str) -> None:
        """Give a command, if the device has it."""
        command = self._read(name, "execute")
        try:
            if command is not None:
                command()
        except self._absent:
            return
        except self.errors as error:
            raise DeviceError(f"the device does not do {name}: {_first_line(error)}") from error

    def choices(self, name: str) -> tuple[str, ...]:
        """What an enumeration can be set to now."""
        return tuple(self._read(name, "symbolics") or ())

    @property
    def _absent(self) -> tuple[type[Exception], ...]:
        return self.genapi.LogicalErrorException, self.genapi.AccessException

    def _allowed(self, name: str) -> str:
        if choices := self.choices(name):
            return f" (possible: {', '.join(choices)})"
        low, high = self._read(name, "min"), self._read(name, "max")
        return "" if low is None or high is None else f" (possible: {low:g} to {high:g})"

    def _read(self, name: str, attribute: str) -> Any:
        try:
            return getattr(self.find(name), self.attribute(attribute), None)
        except self._absent:
            return None
        except self.errors as error:
            raise DeviceError(f"the device does not answer when asked for {name}: {_first_line(error)}") from error


def _first_line(error: Exception) -> str:
    return (str(error).strip() or repr(error)).splitlines()[0]
