"""Links that carry bytes to and from an autopilot, over UDP, TCP and serial lines; only `wait` waits.

None listens but `udpin`, and that on the address that is given; so 127.0.0.1 keeps it to this computer.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
import tty
from typing import NamedTuple, Protocol
from urllib.parse import urlsplit

from ..errors import SettingsError

# At most this much is taken from a link at a time, so that a flood cannot hold up the rest of the node.
READ_BYTES = 16 * 1024
FORMS = "udpin://HOST:PORT, udpout://HOST:PORT, tcp://HOST:PORT or serial:///dev/NAME:BAUD"


class Piece(NamedTuple):
    """Bytes that came together, and the address they came from where a link has several."""

    data: bytes
    sender: tuple[str, int] | None = None


class ByteLink(Protocol):
    """An open link.

    Attributes:
        keeps_boundaries: whether what one `read` part holds was sent as one piece (a datagram).
        notices_loss: whether silence can mean that the link itself is gone and must be opened again.
    """

    keeps_boundaries: bool
    notices_loss: bool

    def fileno(self) -> int: ...

    def read(self) -> list[Piece]:
        """What has come since the last call, in the pieces in which it came.

        Raises:
            OSError: the link is gone.
        """

    def write(self, data: bytes) -> None:
        """Send, or drop what the link cannot take now.

        Raises:
            OSError: the link is gone.
        """

    def answer(self, sender: tuple[str, int] | None) -> None:
        """Write to this sender from now on."""

    def close(self) -> None: ...


def wait(link: ByteLink, timeout_s: float) -> None:
    """Until there is something to read, at most so long."""
    if timeout_s > 0:
        poll = select.poll()  # select() itself refuses descriptors above 1023
        poll.register(link.fileno(), select.POLLIN)
        poll.poll(timeout_s * 1000)


class _SocketLink:
    """What UDP and TCP share."""

    _socket: socket.socket

    def fileno(self) -> int:
        return self._socket.fileno()

    def answer(self, sender: tuple[str, int] | None) -> None:
        """There is but one to write to."""

    def close(self) -> None:
        self._socket.close()


class UdpLink(_SocketLink):
    """Datagrams: to and from one address, or listening on one and writing to the sender that `answer` names."""

    keeps_boundaries = True
    notices_loss = False

    def __init__(self, host: str, port: int, listen: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._listens = listen
        self._peer: tuple[str, int] | None = None
        try:
            if listen:
                self._socket.bind((host, port))
            else:
                self._socket.connect((host, port))  # the kernel then drops what others send
        except OSError:
            self._socket.close()
            raise

    def read(self) -> list[Piece]:
        pieces: list[Piece] = []
        received = 0
        while received < READ_BYTES:
            try:
                pieces.append(Piece(*self._socket.recvfrom(65535)))
            except (BlockingIOError, ConnectionRefusedError):
                break
            received += max(len(pieces[-1].data), 64)  # empty datagrams count too
        return pieces

    def write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):  # nobody listens there yet
            if not self._listens:
                self._socket.send(data)
            elif self._peer is not None:
                self._socket.sendto(data, self._peer)

    def answer(self, sender: tuple[str, int] | None) -> None:
        self._peer = sender


class TcpLink(_SocketLink):
    """A TCP connection to a server."""

    keeps_boundaries = False
    notices_loss = True

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a request must not wait for the next
        try:
            self._socket.connect((host, port))
        except BlockingIOError:
            pass  # goes on by itself; read() tells if it fails
        except OSError:
            self._socket.close()
            raise

    def read(self) -> list[Piece]:
        try:
            data = self._socket.recv(READ_BYTES)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionResetError("the other side has closed the connection")
        # Linux falls back to late acknowledgements by itself. With those, who sends without TCP_NODELAY sends late.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return [Piece(data)]

    def write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            self._socket.send(data)


class SerialLink:
    """A serial line: 8 bits, no parity, no flow control."""

    keeps_boundaries = False
    notices_loss = True

    def __init__(self, device: str, baud: int) -> None:
        self._fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(self._fd)
            speed = getattr(termios, f"B{baud}")
            attributes = termios.tcgetattr(self._fd)
            attributes[2] = attributes[2] & ~termios.CRTSCTS & ~termios.CSTOPB | termios.CLOCAL | termios.CREAD
            attributes[4] = attributes[5] = speed
            termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        except (OSError, termios.error) as error:
            os.close(self._fd)
            raise OSError(f"{device} is not a serial line: {error}") from error

    def fileno(self) -> int:
        return self._fd

    def answer(self, sender: tuple[str, int] | None) -> None:
        """There is but one to write to."""

    def read(self) -> list[Piece]:
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionResetError("the serial line was unplugged")
        return [Piece(data)]

    def write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._fd, data)

    def close(self) -> None:
        os.close(self._fd)


def check_url(url: str) -> None:
    """Refuse a URL that `open_link` does not understand.

    Raises:
        SettingsError: naming the URL and the forms that are understood.
    """
    _parse(url)


def open_link(url: str) -> ByteLink:
    """Open the link that a URL names.

    Raises:
        SettingsError: the URL is none of the forms that are understood.
        OSError: the link cannot be opened now.
    """
    scheme, place, number = _parse(url)
    if scheme == "serial":
        return SerialLink(place, number)
    if scheme == "tcp":
        return TcpLink(place, number)
    return UdpLink(place, number, listen=scheme == "udpin")


def _parse(url: str) -> tuple[str, str, int]:
    """(scheme, host or device, port or baud rate)"""
    scheme, separator, rest = url.partition("://")
    try:
        if scheme == "serial" and separator and rest.startswith("/"):
            device, _, baud = rest.rpartition(":")
            if device and hasattr(termios, f"B{int(baud)}"):
                return scheme, device, int(baud)
        elif scheme in ("udpin", "udpout", "tcp"):
            parts = urlsplit(url)
            if parts.hostname and parts.port and not parts.path:
                return scheme, parts.hostname, parts.port
    except ValueError:
        pass
    raise SettingsError(f"link '{url}' is not understood: give {FORMS} (a baud rate that the system knows)")
