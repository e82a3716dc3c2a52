"""Disks that are small, stall or fail, for tests: real file systems, which only root can make."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest


@contextmanager
def memory_disk(folder: Path, megabytes: int) -> Iterator[Path]:
    """A file system in memory of this size."""
    with _mounted(folder, "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs") as place:
        yield place


@contextmanager
def image_disk(folder: Path, megabytes: int, image: Path | None = None) -> Iterator[tuple[Path, Path]]:
    """An ext4 file system in a file: (where it is mounted, the file). The file is made if it is not there."""
    file = image or folder / "disk.img"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("wb") as disk:
            disk.truncate(megabytes * 1024 * 1024)
        small = ("-m", "0", "-N", "64", "-J", "size=4", "-E", "nodiscard")  # it takes the room of what is in it
        _do("mkfs.ext4", "-q", "-F", *small, str(file))
    with _mounted(folder, "-o", "loop", str(file)) as place:
        yield place, file


@contextmanager
def frozen(place: Path) -> Iterator[None]:
    """Within it nothing can be written to the file system: who tries waits."""
    _do("fsfreeze", "-f", str(place))
    try:
        yield
    finally:
        _do("fsfreeze", "-u", str(place))


@contextmanager
def _mounted(folder: Path, *arguments: str) -> Iterator[Path]:
    if os.geteuid() != 0:
        pytest.skip("needs root, to mount a small disk: run the tests with sudo")
    place = folder / "disk"
    place.mkdir(parents=True)
    _do("mount", *arguments, str(place))
    try:
        yield place
    finally:
        if subprocess.run(["umount", str(place)], capture_output=True).returncode:
            _do("umount", "--lazy", str(place))
        with suppress(OSError):
            place.rmdir()


def _do(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip(f"{command[0]} is missing: sudo apt install e2fsprogs mount util-linux")
    if done.returncode:
        pytest.skip(f"this machine cannot do `{' '.join(command)}`: {done.stderr.strip()}")
