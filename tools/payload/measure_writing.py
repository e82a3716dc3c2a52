"""What writing an image of full size costs, by its parts: processor time for each image, and at 60 Hz.

    tools/run python tools/payload/measure_writing.py

Prints the table of docs/decisions/recorder.md. The files are written to the temporary folder, and deleted.
"""

from __future__ import annotations

import argparse
import mmap
import os
import tempfile
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from fastcrc import crc32
from mcap.writer import CompressionType, Writer
from rgbd_dic_acquisition.disk_file import BLOCK_BYTES
from rgbd_dic_acquisition.mcap_file import McapFile
from rgbd_dic_acquisition.nodes.large_pages import use_large_pages
from rgbd_dic_acquisition.nodes.spinning import prepare_process

KIND = "sensor_msgs/msg/Image"


def library(path: Path, images: list[bytes], count: int) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        channel = writer.register_channel("/image", "cdr", writer.register_schema(KIND, "ros2msg", b""), {})
        for number in range(count):
            writer.add_message(channel, number, images[number % len(images)], number)
        writer.finish()


def ours(path: Path, images: list[bytes], count: int, direct: bool = False) -> None:
    file = McapFile(path, direct=direct)
    channel = file.add_channel("/image", KIND, b"", {})
    for number in range(count):
        file.write(channel, number, number, number, images[number % len(images)])
    file.close("rosbag2", dict)


def past_the_kernel(path: Path, images: list[bytes], count: int) -> None:
    """The floor: a copy to where a block begins, and the disk fetches it from there."""
    size = len(images[0]) // BLOCK_BYTES * BLOCK_BYTES
    wholes, memory = [image[:size] for image in images], memoryview(mmap.mmap(-1, size))
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_DIRECT)
    for number in range(count):
        memory[:] = wholes[number % len(wholes)]
        os.write(descriptor, memory)
    os.close(descriptor)


def kernel(path: Path, images: list[bytes], count: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT)
    for number in range(count):
        os.write(descriptor, images[number % len(images)])
    os.close(descriptor)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=300)
    count = parser.parse_args().images
    use_large_pages()
    prepare_process()  # the allocator of a node
    rng = np.random.default_rng(1)
    images = [rng.integers(0, 256, 1440 * 1080, np.uint8).tobytes() for _ in range(6)]

    def each(work: Callable[[bytes], object]) -> Callable[[Path, list[bytes], int], None]:
        def run(_: Path, images: list[bytes], count: int) -> None:
            for number in range(count):
                work(images[number % len(images)])

        return run

    rows = {
        "a copy in memory": each(bytearray),
        "checksum by zlib": each(zlib.crc32),
        "checksum by fastcrc": each(crc32.iso_hdlc),
        "copied into the kernel's memory for files": kernel,
        "copied, and from there to the disk, past that memory": past_the_kernel,
        "written by the `mcap` library (two copies, checksum by zlib, into the kernel)": library,
        "written by `McapFile` (checksum by fastcrc, into the kernel)": ours,
        "written by `McapFile` past the kernel's memory (checksum by fastcrc, no copy)": partial(ours, direct=True),
    }
    print("| Part | processor for an image [ms] | at 60 Hz [% of a core] |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, work in rows.items():
            path, spent = Path(folder, "file.mcap"), []
            for _ in range(3):
                before = time.process_time()
                work(path, images, count)
                spent.append((time.process_time() - before) / count)
                path.unlink(missing_ok=True)
            print(f"| {name} | {1e3 * min(spent):.2f} | {6000 * min(spent):.1f} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
