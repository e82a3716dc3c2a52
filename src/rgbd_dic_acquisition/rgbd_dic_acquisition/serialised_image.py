"""An Image of the middleware as its bytes are, without a copy of the pixels."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import ImageError


@dataclass(frozen=True)
class SerialisedImage:
    """A sensor_msgs/Image, as `image_from_message` and `depth_from_message` read it; `data` is a view of the bytes."""

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: NDArray[np.uint8]

    @classmethod
    def of(cls, serialised: bytes) -> SerialisedImage:
        """From CDR: four bytes of which the second tells the byte order, then the fields, each number where a multiple
        of its size begins.

        Raises:
            ImageError: the bytes are not such a message.
        """
        try:
            order = "<" if serialised[1] & 1 else ">"
            sec, nanosec = struct.unpack_from(order + "iI", serialised, 4)
            frame_id, at = _text(serialised, order, 12)
            height, width = struct.unpack_from(order + "II", serialised, at)
            encoding, at = _text(serialised, order, at + 8, aligned=False)
            is_bigendian = bool(serialised[at])
            at = _aligned(at + 1)
            step, size = struct.unpack_from(order + "II", serialised, at)
            data = np.frombuffer(serialised, np.uint8, size, at + 8)
        except (IndexError, ValueError, struct.error) as error:
            raise ImageError(f"{len(serialised)} bytes are no image message ({error})") from error
        stamp_ns = sec * 1_000_000_000 + nanosec
        return cls(stamp_ns, frame_id, height, width, encoding, is_bigendian, step, data)


def _text(serialised: bytes, order: str, at: int, aligned: bool = True) -> tuple[str, int]:
    """A string: its length, its bytes and a zero; and where it ends, or where the next number begins."""
    (length,) = struct.unpack_from(order + "I", serialised, at)
    end = at + 4 + length
    if not 0 < length <= len(serialised) - at - 4:
        raise ValueError(f"a text of {length} bytes at {at}")
    return serialised[at + 4 : end - 1].decode(), _aligned(end) if aligned else end


def _aligned(at: int) -> int:
    return at + -at % 4
