"""metadata.yaml of a bag, as ros2 bag has it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

NAME = "metadata.yaml"


@dataclass
class Topic:
    """What a bag says about a topic, and how many messages of it there are."""

    name: str
    type: str
    type_hash: str
    offered_qos: list[dict[str, Any]]
    count: int = 0


@dataclass
class Span:
    """Log times of the first and the last message of one file [ns], None while there is none; how many there are."""

    first_ns: int | None = None
    last_ns: int = 0
    count: int = 0

    def add(self, log_time_ns: int) -> None:
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        self.last_ns = max(self.last_ns, log_time_ns)
        self.count += 1


def information(files: dict[str, Span], topics: Sequence[Topic]) -> dict[str, Any]:
    """The content of metadata.yaml below its top key, from each file's name and span."""
    started = [span for span in files.values() if span.first_ns is not None]
    whole = Span(
        min((span.first_ns for span in started), default=None),
        max((span.last_ns for span in started), default=0),
        sum(span.count for span in files.values()),
    )
    content = {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": list(files),
        **_described(whole),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": topic.offered_qos,
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": name, **_described(span)} for name, span in files.items()],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    return json.loads(json.dumps(content))  # separate copies, so that the YAML has no anchors


def write(folder: Path, content: dict[str, Any]) -> None:
    """Write `information` into the folder of a bag."""
    text = yaml.safe_dump({"rosbag2_bagfile_information": content}, sort_keys=False)
    (folder / NAME).write_text(text)


def _described(span: Span) -> dict[str, Any]:
    start_ns = span.first_ns or 0
    return {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": max(0, span.last_ns - start_ns)},
        "message_count": span.count,
    }
