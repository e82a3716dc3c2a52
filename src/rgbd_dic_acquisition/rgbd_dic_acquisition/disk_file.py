"""A file that grows, written through the kernel's memory for files, or past it.

Through that memory costs the processor more: a copy into it, page by page, bringing the pages to the disk, and giving
them back. What goes past it is whole blocks of the disk, from memory where a page begins (open(2), O_DIRECT): the pages
of a large message whose bytes have the same place in a page as in a block, and copies of what is between those.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

BLOCK_BYTES = 4096
LARGE_BYTES = 16 * BLOCK_BYTES  # less is copied
_LARGE_PAGE_BYTES = 2 << 20
_DIRECT = getattr(os, "O_DIRECT", 0)
_MOST_PIECES = 1024  # that the kernel takes at a time (IOV_MAX)


class DiskFile:
    """A new file, open for writing.

    Args:
        direct: go past the kernel's memory, if the file system can.

    Attributes:
        direct: whether that is so; all that is written is then whole blocks, and at their places.

    Raises:
        OSError: the file is there already, or the disk refuses.
    """

    def __init__(self, path: Path, direct: bool = False) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self._memory = memoryview(mmap.mmap(-1, BLOCK_BYTES))
        try:
            self.direct = direct and self._goes_past()
        except OSError:
            os.close(self._descriptor)
            path.unlink()
            raise

    @property
    def closed(self) -> bool:
        return self._descriptor < 0

    def write(self, pieces: Sequence[bytes], at: int) -> int:
        """Write these one after another, from there on; returns where they end. If that fails, the file ends before.

        Raises:
            OSError: the disk refuses.
        """
        rest, end = [memoryview(piece) for piece in (self._blocks(pieces) if self.direct else pieces) if piece], at
        try:
            while rest:
                written = os.pwritev(self._descriptor, rest[:_MOST_PIECES], end)
                end += written
                while rest and written >= len(rest[0]):
                    written -= len(rest.pop(0))
                if written:
                    rest[0] = rest[0][written:]
        except OSError:
            with suppress(OSError):
                self.cut(at)
            raise
        return end

    def cut(self, at: int) -> None:
        """Let the file end there."""
        os.ftruncate(self._descriptor, at)

    def go_through_the_kernel(self) -> None:
        """From now on, so that the file can end within a block."""
        self._set(0)
        self.direct = False

    def duplicate(self) -> int:
        """A descriptor of its own, such as for another thread to wait with until all is on the disk."""
        return os.dup(self._descriptor)

    def sync(self) -> None:
        """Wait until all is on the disk."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        os.close(self._descriptor)
        self._descriptor = -1

    def _blocks(self, pieces: Sequence[bytes]) -> list[memoryview]:
        """These as whole blocks: right from the large ones that lie as in the file, the rest from a copy."""
        size = sum(map(len, pieces))
        if size > len(self._memory):
            self._memory = _memory(size)
        blocks, at, begun, end = [], 0, 0, 0  # `begun` to `end` are the copies that are not in `blocks` yet
        for piece in pieces:
            rest = memoryview(piece)
            if len(piece) >= LARGE_BYTES and (place_in_block(piece) - at) % BLOCK_BYTES == 0:
                first = -at % BLOCK_BYTES
                last = first + (len(piece) - first) // BLOCK_BYTES * BLOCK_BYTES
                self._memory[end : end + first] = rest[:first]
                blocks += [self._memory[begun : end + first], rest[first:last]]
                begun = end = end + first
                rest = rest[last:]
            self._memory[end : end + len(rest)] = rest
            end += len(rest)
            at += len(piece)
        return [*blocks, self._memory[begun:end]]

    def _goes_past(self) -> bool:
        try:
            self._set(_DIRECT)
            os.pwrite(self._descriptor, self._memory[:BLOCK_BYTES], 0)
            self.cut(0)
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            self._set(0)  # the file system cannot
            return False
        return _DIRECT != 0

    def _set(self, flag: int) -> None:
        flags = fcntl.fcntl(self._descriptor, fcntl.F_GETFL)
        fcntl.fcntl(self._descriptor, fcntl.F_SETFL, flags & ~_DIRECT | flag)


def place_in_block(piece: bytes) -> int:
    """Where in a block of the memory it begins."""
    return np.frombuffer(piece, np.uint8).__array_interface__["data"][0] % BLOCK_BYTES


def _memory(size: int) -> memoryview:
    """In large pages, if the kernel has them."""
    memory = mmap.mmap(-1, -(-size // _LARGE_PAGE_BYTES) * _LARGE_PAGE_BYTES, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    with suppress(OSError, AttributeError):
        memory.madvise(mmap.MADV_HUGEPAGE)
    return memoryview(memory)
