"""Where processes listen, by the kernel's tables."""

from __future__ import annotations

import ipaddress
import os
import struct
from pathlib import Path
from typing import NamedTuple

TCP_LISTENS, UDP_UNCONNECTED = "0A", "07"  # to others a socket is deaf


class Socket(NamedTuple):
    protocol: str
    address: str
    port: int


def open_to_others(process: int) -> list[Socket]:
    """Sockets of a process that take what anybody sends to their address."""
    inodes = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        try:
            inodes.add(os.readlink(link))
        except OSError:  # closed meanwhile
            continue
    found = []
    for protocol in ("udp", "udp6", "tcp", "tcp6"):
        wanted = TCP_LISTENS if protocol.startswith("tcp") else UDP_UNCONNECTED
        for line in Path(f"/proc/{process}/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == wanted and f"socket:[{fields[9]}]" in inodes:
                address, port = fields[1].split(":")
                found.append(Socket(protocol, _address(address), int(port, 16)))
    return found


def beyond_loopback(process: int) -> list[Socket]:
    """Those that another computer reaches."""
    return [each for each in open_to_others(process) if not ipaddress.ip_address(each.address).is_loopback]


def _address(text: str) -> str:
    """The kernel writes words of four bytes in the machine's order."""
    words = [int(text[at : at + 8], 16) for at in range(0, len(text), 8)]
    return str(ipaddress.ip_address(struct.pack(f"={len(words)}I", *words)))
