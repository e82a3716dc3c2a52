"""What the recorder can be told."""

from __future__ import annotations

from dataclasses import dataclass

from ..settings import Settings, setting


@dataclass(frozen=True)
class RecorderSettings(Settings):
    """What is recorded, and how."""

    topics: tuple[str, ...] = setting(
        (),
        doc="'NAME TYPE', with 'latched' or 'best_effort' after it where that is how the topic is offered; "
        "empty records every topic of the node's namespace and /tf_static as they appear",
    )
    queue_depth: int = setting(
        200, doc="messages of a topic kept while the node is busy", unit="messages", low=1, high=10000
    )
    compression: str = setting(
        "none", doc="of the bag; zstd costs half a core and saves little", choices=("none", "zstd")
    )
    split_mb: int = setting(
        4000, doc="size of a file of the bag at which the next is begun; 0 makes one file", unit="MB", low=0
    )
    buffer_mb: int = setting(
        512, doc="messages kept while the disk is slow; more are dropped, counted and told", unit="MB", low=16
    )
    reserve_mb: int = setting(
        256, doc="left free on the disk when the bag is ended; 0 goes on until the disk refuses", unit="MB", low=0
    )
    warning_s: float = setting(
        300.0, doc="the level is WARN when the disk will be full sooner than that", unit="s", low=0.0
    )
    linger_s: float = setting(
        3.0,
        doc="told to end, it goes on while others publish what it records, at most this long: nodes that end "
        "together with it say their last",
        unit="s",
        low=0.0,
    )
