"""A slow network between a viewer and the pages' server, on this computer."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time

CHUNK = 1024  # bytes that are handed on at a time, so that connections share the link
BUFFER = 8192  # bytes that wait in the link


class SlowLink:
    """Listens on a port of the loopback and hands everything on; answers come at so many bytes a second in all.

    Attributes:
        port: where it listens.
        bytes_per_s: may be changed at any time.
    """

    def __init__(self, to_port: int, bytes_per_s: float):
        self.bytes_per_s, self._to_port, self._free_s = bytes_per_s, to_port, 0.0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        self._loop.run_until_complete(asyncio.start_server(self._connect, sock=self._listener))
        self._loop.run_forever()

    async def _connect(self, viewer: asyncio.StreamReader, to_viewer: asyncio.StreamWriter) -> None:
        upstream = socket.socket()
        upstream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        upstream.setblocking(False)
        await self._loop.sock_connect(upstream, ("127.0.0.1", self._to_port))
        server, to_server = await asyncio.open_connection(sock=upstream, limit=CHUNK)
        await asyncio.gather(self._copy(viewer, to_server, paced=False), self._copy(server, to_viewer, paced=True))

    async def _copy(self, source: asyncio.StreamReader, target: asyncio.StreamWriter, paced: bool) -> None:
        with contextlib.suppress(ConnectionError):
            while data := await source.read(CHUNK):
                if paced:
                    self._free_s = max(self._free_s, time.monotonic()) + len(data) / self.bytes_per_s
                    await asyncio.sleep(self._free_s - time.monotonic())
                target.write(data)
                await target.drain()
        target.close()
