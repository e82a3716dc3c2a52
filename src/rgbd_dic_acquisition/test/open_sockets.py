"""Where processes listen, by the kernel's tables."""

from __future__ import annotations

import ipaddress
import os
import socket
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

TCP_LISTENS, UDP_UNCONNECTED = "0A", "07"  # to strangers all others are deaf
READ_S = 2.0  # within which a datagram is read, if anybody reads


class Socket(NamedTuple):
    protocol: str
    address: str
    port: int
    waiting: int  # bytes that nobody has read yet


def open_sockets(process: int) -> list[Socket]:
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
                (address, port), (_, waiting) = fields[1].split(":"), fields[4].split(":")
                found.append(Socket(protocol, _address(address), int(port, 16), int(waiting, 16)))
    return found


def heard_beyond_loopback(processes: Mapping[str, int]) -> dict[str, list[Socket]]:
    """By name, the sockets that another computer reaches, and that are read.

    DDS also opens some only to send from them; what comes to those stays in the kernel. So each is sent something.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for each in (each for process in processes.values() for each in _beyond_loopback(process)):
            if each.protocol == "udp":
                stranger.sendto(
                    b"is anybody there?", ("127.0.0.1" if each.address == "0.0.0.0" else each.address, each.port)
                )
    time.sleep(READ_S)
    heard = {
        name: [each for each in _beyond_loopback(process) if not each.waiting] for name, process in processes.items()
    }
    return {name: found for name, found in heard.items() if found}


def _beyond_loopback(process: int) -> list[Socket]:
    return [each for each in open_sockets(process) if not ipaddress.ip_address(each.address).is_loopback]


def _address(text: str) -> str:
    """The kernel writes words of four bytes in the machine's order."""
    words = [int(text[at : at + 8], 16) for at in range(0, len(text), 8)]
    return str(ipaddress.ip_address(struct.pack(f"={len(words)}I", *words)))
