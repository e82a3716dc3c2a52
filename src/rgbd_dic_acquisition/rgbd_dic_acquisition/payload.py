"""payload.yaml: the parameters of the sensor nodes on a real payload, read without ROS (docs/payload.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from .errors import SettingsError
from .settings import Settings

S = TypeVar("S", bound=Settings)
SENSORS = ("camera_node", "tof_node")


@dataclass(frozen=True)
class Payload:
    """A ROS parameter file, by the names of its nodes; namespaces are left out of account.

    Attributes:
        parameters: node -> its parameters, nested as in the file.
    """

    path: Path
    parameters: dict[str, dict[str, Any]]

    def flat(self, node: str) -> dict[str, Any]:
        """The parameters of a node by their full names, such as aravis.serial; empty if the file has no such node."""
        return dict(_flat(self.parameters.get(node, {})))

    def settings(self, node: str, group: str, kind: type[S]) -> S:
        """A group of a node's parameters as the settings that the node makes of it.

        Raises:
            SettingsError: if one is refused.
        """
        values = self.parameters.get(node, {}).get(group, {})
        return kind.from_mapping(values, f"{self.path}: {node}: {group}")

    def source(self, node: str) -> str:
        """Where a sensor node takes its frames from.

        Raises:
            SettingsError: if the file does not say it.
        """
        source = self.parameters.get(node, {}).get("source")
        if not source:
            raise SettingsError(
                f"{self.path}: {node} has no parameter 'source': name the sensor that it reads (docs/payload.md)"
            )
        return str(source)

    @property
    def calibration(self) -> Path | None:
        """The calibration.yaml that camera_node is given, if any."""
        path = self.parameters.get("camera_node", {}).get("calibration")
        return Path(path).expanduser() if path else None


def load_payload(path: Path) -> Payload:
    """Read a ROS parameter file; what it says of `/**` holds for each node that it names.

    Raises:
        SettingsError: if it cannot be read, or names no parameters.
    """
    try:
        content = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"cannot read {path}: {error}; give the payload's file with --payload") from error
    found = list(_nodes(content, ""))
    if not found:
        raise SettingsError(f"{path}: no entry ros__parameters: see the examples in docs/payload.md")
    parameters: dict[str, dict[str, Any]] = {}
    common = [values for name, values in found if name == "**"]
    for name in dict.fromkeys(name for name, _ in found if name != "**"):
        parameters[name] = {}
        for values in (*common, *(own for other, own in found if other == name)):
            _merge(parameters[name], values)
    return Payload(path, parameters)


def _nodes(content: Any, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """(last word of a node's name, parameters) of a parameter file, in its order."""
    if not isinstance(content, Mapping):
        return
    for key, value in content.items():
        if key == "ros__parameters" and isinstance(value, Mapping):
            yield name.rsplit("/", 1)[-1], dict(value)
        else:
            yield from _nodes(value, str(key))


def _merge(target: dict[str, Any], values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, Mapping):
            _merge(target.setdefault(name, {}), value)
        else:
            target[name] = value


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
