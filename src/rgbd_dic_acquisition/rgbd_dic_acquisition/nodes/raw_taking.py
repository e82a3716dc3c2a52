"""Taking of serialised messages right into Python's bytes, through the C interface that rclpy itself calls.

rclpy copies a message out of the middleware and then once more, into bytes. That second copy of every image was a
seventh of the recorder's processor time (docs/decisions/recorder.md).
"""

from __future__ import annotations

import ctypes
from typing import NamedTuple

from rclpy.subscription import Subscription

from ..errors import RgbdDicError

_TAKE_FAILED = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED: nothing is there
_new_bytes, _address = ctypes.pythonapi.PyBytes_FromStringAndSize, ctypes.pythonapi.PyBytes_AsString
_new_bytes.restype, _new_bytes.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_ssize_t)
_address.restype, _address.argtypes = ctypes.c_void_p, (ctypes.py_object,)
_REALLOCATE = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t"""

    _fields_ = (
        ("allocate", ctypes.c_void_p),
        ("deallocate", ctypes.c_void_p),
        ("reallocate", _REALLOCATE),
        ("zero_allocate", ctypes.c_void_p),
        ("state", ctypes.c_void_p),
    )


class _Message(ctypes.Structure):
    """rcl_serialized_message_t"""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Info(ctypes.Structure):
    """rmw_message_info_t; what follows is not read, and has room."""

    _fields_ = (
        ("source_ns", ctypes.c_int64),
        ("received_ns", ctypes.c_int64),
        ("number", ctypes.c_uint64),
        ("rest", ctypes.c_uint8 * 256),
    )


class Taken(NamedTuple):
    """A message as its publisher serialised it.

    Attributes:
        received_ns: when it arrived; 0 where the middleware does not say.
        number: that its publisher gave it.
    """

    data: bytes
    received_ns: int
    number: int


class RawTaking:
    """Takes messages of subscriptions. Not for several threads."""

    def __init__(self) -> None:
        # rclpy has loaded both. As with its own calls, no other thread of Python runs meanwhile: it would have to be
        # stopped again for the callback.
        rcl, utils = ctypes.PyDLL("librcl.so"), ctypes.PyDLL("librcutils.so")
        self._take = rcl.rcl_take_serialized_message
        self._take.argtypes = (ctypes.c_void_p, ctypes.POINTER(_Message), ctypes.POINTER(_Info), ctypes.c_void_p)
        utils.rcutils_get_default_allocator.restype = _Allocator
        self._allocator = utils.rcutils_get_default_allocator()
        self._allocator.reallocate = _REALLOCATE(self._room)
        self._info, self._data = _Info(), b""

    def take(self, subscription: Subscription) -> Taken | None:
        """The oldest message that has arrived and not been taken.

        Raises:
            RgbdDicError: the middleware refuses.
        """
        message = _Message(None, 0, 0, self._allocator)
        with subscription.handle:
            code = self._take(subscription.handle.pointer, message, self._info, None)
        if code == _TAKE_FAILED:
            return None
        if code != 0:
            raise RgbdDicError(f"{subscription.topic_name}: the middleware gives error {code} in place of a message")
        data, self._data = self._data, b""
        return Taken(data, self._info.received_ns, self._info.number)

    def _room(self, _: int | None, size: int, __: int | None) -> int:
        """The middleware knows the size of a message and asks once; then it fills all of it."""
        self._data = _new_bytes(None, size)
        return _address(self._data)
