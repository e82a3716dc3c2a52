"""Message types without ROS: those of Jazzy from the bag library, ours and others from the ament index."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from .errors import BagError


@functools.cache
def typestore() -> Typestore:
    """The types of ROS 2 Jazzy and all of rgbd_dic_msgs.

    Raises:
        BagError: rgbd_dic_msgs is not built or not on AMENT_PREFIX_PATH.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    _register_package(store, "rgbd_dic_msgs")
    return store


def know_type(typename: str) -> None:
    """Make sure that `typestore()` has a type such as sensor_msgs/msg/Imu, if need be from the ament index.

    Raises:
        BagError: there is no such type.
    """
    if typename in typestore().fielddefs:
        return
    package, _, name = typename.partition("/msg/")
    if not name:
        raise BagError(f"'{typename}' is not the name of a message type, such as sensor_msgs/msg/Image")
    _register_package(typestore(), package)
    if typename not in typestore().fielddefs:
        raise BagError(f"package {package} has no message '{name}'")


def make_message(typename: str, **fields: Any) -> Any:
    """A message that `serialise` takes; fields that are not given are zero, empty or false, as in ROS.

    Numbers in arrays may be lists, arrays or (for uint8) bytes.

    Raises:
        BagError: no such type, or no such field.
    """
    know_type(typename)
    definitions = dict(typestore().fielddefs[typename][1])
    unknown = sorted(set(fields) - set(definitions))
    if unknown:
        raise BagError(f"{typename} has no field {', '.join(unknown)}; it has {', '.join(definitions)}")
    values = {
        name: _converted(kind, fields[name]) if name in fields else _default(kind) for name, kind in definitions.items()
    }
    return typestore().types[typename](**values)


def serialise(message: Any) -> bytes:
    """CDR bytes of a message made by `make_message` or read from a bag."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def definition(typename: str) -> tuple[str, str]:
    """The text of a message type with all that it contains (`ros2msg`), and its hash (RIHS01)."""
    know_type(typename)
    return typestore().generate_msgdef(typename, ros_version=2)[0], typestore().hash_rihs01(typename)


def _register_package(store: Typestore, package: str, seen: frozenset[str] = frozenset()) -> None:
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, LookupError, ValueError) as error:
        raise BagError(
            f"message package {package} is not found: build the workspace (make build, or colcon build) and "
            "enter its environment, so that AMENT_PREFIX_PATH names it"
        ) from error
    types: dict[str, Any] = {}
    for path in sorted((share / "msg").glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(), f"{package}/msg/{path.stem}"))
    store.register({name: kind for name, kind in types.items() if name not in store.fielddefs})
    for needed in {name for kind in types.values() for name in _nested(kind)} - set(store.fielddefs):
        needed_package = needed.partition("/")[0]
        if needed_package not in seen:
            _register_package(store, needed_package, seen | {package})


def _nested(kind: Any) -> set[str]:
    found = set()
    for _, (node, content) in kind[1]:
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, content = content[0]
        if node == Nodetype.NAME:
            found.add(content)
    return found


def _converted(kind: Any, value: Any) -> Any:
    node, content = kind
    if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return value
    (item_node, item), _ = content
    if item_node != Nodetype.BASE or item[0] == "string":
        return list(value)
    dtype = _number_type(item[0])
    is_bytes = isinstance(value, (bytes, bytearray, memoryview))
    return np.frombuffer(value, np.uint8) if is_bytes else np.asarray(value, dtype)


def _default(kind: Any) -> Any:
    node, content = kind
    if node == Nodetype.NAME:
        return make_message(content)
    if node == Nodetype.BASE:
        return "" if content[0] == "string" else _number_type(content[0]).type(0).item()
    (item_node, item), length = content
    count = length if node == Nodetype.ARRAY else 0
    if item_node == Nodetype.BASE and item[0] != "string":
        return np.zeros(count, _number_type(item[0]))
    return [_default((item_node, item)) for _ in range(count)]


def _number_type(name: str) -> np.dtype[Any]:
    return np.dtype({"byte": "uint8", "char": "uint8"}.get(name, name))
