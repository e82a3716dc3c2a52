"""Repair of bags that were not closed: power loss, a full disk, a recorder that was killed.

What is whole is written into a new bag with index and metadata.yaml; the old one is only read.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from . import bag_metadata
from .bag_metadata import Topic
from .bag_reader import BagReader, mcap_files
from .bag_writer import CHUNK_BYTES
from .errors import BagError
from .mcap_salvage import SalvagedFile

_COMPRESSIONS = {"": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}


@dataclass(frozen=True)
class Repair:
    """What became of a bag.

    Attributes:
        path: the new bag; None if there was nothing to repair.
        messages: how many are whole.
        damaged_chunks: chunks that were left out for their checksum.
        lost_bytes: of all files, in damaged chunks and from the cut on.
    """

    path: Path | None
    messages: int
    damaged_chunks: int
    lost_bytes: int


def repair_bag(path: Path, output: Path | None = None) -> Repair:
    """Make a new bag of what is whole in one that is cut off, damaged or without metadata.yaml.

    Args:
        path: directory of a bag, or one .mcap file.
        output: directory to be made; `<name>_repaired` beside the bag if not given. Files that are whole are linked
            into it, where the file system can do that, and else copied.

    Raises:
        BagError: there is no bag, nothing in it is whole, `output` exists, or the disk refuses.
    """
    files = [SalvagedFile(file) for file in mcap_files(path)]
    topics: dict[str, Topic] = {}
    for file in files:
        _count(file, topics)
    messages = sum(file.span.count for file in files)
    if all(file.is_whole for file in files) and _opens(path):
        return Repair(None, messages, 0, 0)
    if not messages:
        raise BagError(f"{path} holds no whole chunk of messages: there is nothing that could be repaired")
    output = output or path.resolve().parent / f"{path.stem if path.is_file() else path.resolve().name}_repaired"
    if output.exists():
        raise BagError(f"{output} exists already: remove it first, or choose another name with --out")
    try:
        _write(path, [file for file in files if file.span.count], output, topics)
    except OSError as error:
        shutil.rmtree(output, ignore_errors=True)
        raise BagError(
            f"cannot write the repaired bag {output}: {error.strerror}. Choose another disk with --out"
        ) from error
    return Repair(output, messages, sum(f.damaged_chunks for f in files), sum(f.lost_bytes for f in files))


def _opens(path: Path) -> bool:
    try:
        with BagReader(path):
            return path.is_file() or (path / bag_metadata.NAME).exists()
    except BagError:
        return False


def _count(file: SalvagedFile, topics: dict[str, Topic]) -> None:
    """Go through a file once; add its topics and its messages to those of the bag."""
    counts: dict[str, int] = {}
    for channel, _ in file.messages():
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
    for channel, schema in file.channels.values():
        topics.setdefault(channel.topic, _topic(channel, schema))
    for name, count in counts.items():
        topics[name].count += count


def _topic(channel: Channel, schema: Schema) -> Topic:
    text = channel.metadata.get("offered_qos_profiles", "")
    qos = yaml.safe_load(text) if "&" not in text else None  # no anchors, which could make much of little
    return Topic(channel.topic, schema.name, channel.metadata.get("topic_type_hash", ""), qos or [])


def _write(path: Path, files: list[SalvagedFile], output: Path, topics: dict[str, Topic]) -> None:
    output.mkdir(parents=True)
    spans = {}
    for number, file in enumerate(files):
        target = output / f"{output.name}_{number}.mcap"
        spans[target.name] = file.span
        if file.is_whole and _opens(file.path):
            _link(file.path, target)
        else:
            _copy_messages(file, target)
    bag_metadata.write(output, bag_metadata.information(spans, list(topics.values())))
    for other in path.iterdir() if path.is_dir() else ():  # calibration.yaml, regions.yaml
        if other.is_file() and other.suffix != ".mcap" and other.name != bag_metadata.NAME:
            shutil.copy2(other, output)


def _copy_messages(file: SalvagedFile, target: Path) -> None:
    with target.open("wb") as output:
        writer = Writer(output, chunk_size=CHUNK_BYTES, compression=_COMPRESSIONS[file.compression])
        writer.start(profile="ros2", library="rgbd_dic")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for number, (channel, schema) in list(file.channels.items()):
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            about = (channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata)
            channels[number] = writer.register_channel(*about)
        for channel, message in file.messages():
            about = (message.log_time, message.data, message.publish_time, message.sequence)
            writer.add_message(channels[channel.id], *about)
        writer.finish()


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copy2(source, target)
