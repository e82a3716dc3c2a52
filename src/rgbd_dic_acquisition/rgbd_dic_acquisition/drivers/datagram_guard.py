"""A UDP socket that a library has opened: whose datagrams the kernel lets in, and how many of them wait for it."""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from pathlib import Path

from ..errors import DeviceError

SO_ATTACH_FILTER = 26
SOURCE = 0xFFF00000 + 12  # where a filter finds the sender's address: SKF_NET_OFF, and its place in the IPv4 header
LOAD, JUMP_IF_EQUAL, RETURN = 0x20, 0x15, 0x06  # of the kernel's filter machine


def accept_only_from(address: str, port: int) -> None:
    """Guard this process' socket on a UDP port.

    Raises:
        DeviceError: there is no such socket, or it cannot be guarded.
    """
    sender = struct.unpack(">I", socket.inet_aton(address))[0]
    program = [(LOAD, 0, 0, SOURCE), (JUMP_IF_EQUAL, 0, 1, sender), (RETURN, 0, 0, 0xFFFFFFFF), (RETURN, 0, 0, 0)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in program))
    try:
        guarded = [sock.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, _pointer(program, code)) for sock in _on(port)]
    except OSError as error:
        raise DeviceError(f"strangers cannot be kept from the images' port {port}: {error}") from error
    if not guarded:
        raise DeviceError(f"no socket of this process is on port {port}, where the images should come in")


def let_wait(port: int, size_bytes: int) -> None:
    """Let so many bytes wait at this process' socket on a UDP port; the system gives no more than net.core.rmem_max."""
    for sock in _on(port):
        with sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)


def _pointer(program: list[tuple[int, int, int, int]], code: ctypes.Array) -> bytes:
    return struct.pack("HP", len(program), ctypes.addressof(code))


def _on(port: int) -> list[socket.socket]:
    """The sockets on a UDP port, by handles of their own."""
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        try:
            if not os.readlink(entry).startswith("socket:"):
                continue
            sock = socket.socket(fileno=os.dup(int(entry.name)))
        except OSError:  # closed meanwhile
            continue
        datagrams = sock.family == socket.AF_INET and sock.type & socket.SOCK_DGRAM
        if datagrams and sock.getsockname()[1] == port:
            found.append(sock)
        else:
            sock.close()
    return found
