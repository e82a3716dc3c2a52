"""MAVLink messages from bytes and back, by pymavlink; garbage between messages costs none of them."""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import common as mavlink

MARKERS = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
BAD_DATA = "BAD_DATA"  # what pymavlink calls bytes that are no message


class MavlinkCodec:
    """One direction of one link each: a new one is needed when the link is opened anew."""

    def __init__(self, own_system_id: int) -> None:
        self._mav = mavlink.MAVLink(None, own_system_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._mav.robust_parsing = True

    def pack(self, message: mavlink.MAVLink_message) -> bytes:
        """The bytes of the next message to send."""
        packed = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def messages(self, piece: bytes, is_whole: bool) -> Iterator[mavlink.MAVLink_message]:
        """The messages that end in this piece, and BAD_DATA for each run of bytes that are none.

        Args:
            is_whole: no message goes on in the next piece (datagrams).
        """
        mav = self._mav
        message = mav.parse_char(piece)
        while message is not None:
            yield message
            frame = bytes(message.data if message.get_type() == BAD_DATA else message.get_msgbuf())
            if self._is_false_start(message, frame):
                # pymavlink has skipped as many bytes as garbage promised; look for messages among them.
                mav.buf[: mav.buf_index] = frame[1:]
                mav.buf_index = 0
            message = mav.parse_char(b"")
        del mav.buf[: mav.buf_index]
        mav.buf_index = 0
        if is_whole:
            mav.buf.clear()

    def _is_false_start(self, message: mavlink.MAVLink_message, frame: bytes) -> bool:
        if message.get_type() == BAD_DATA:
            return frame[0] in MARKERS
        if not message.get_type().startswith("UNKNOWN"):
            return False
        following = self._mav.buf[self._mav.buf_index :][:1]
        return len(following) == 1 and following[0] not in MARKERS  # it has no known checksum
