"""Plays a bag: at a rate, or as fast as the graph keeps up."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rclpy.node import Node

from ..bag import BagReader
from ..errors import RgbdDicError, SettingsError
from ..in_flight import header_stamp_ns
from ..settings import Settings, setting
from .answers import Answers
from .diagnostics import Diagnostics, WatchedPublisher
from .parameters import declare, declare_path
from .played_topics import PlayedTopics
from .spinning import run
from .strangers import strangers

STEP_S = 0.05


@dataclass(frozen=True)
class PlayerSettings(Settings):
    """What is played, how fast, and what it waits for."""

    rate: float = setting(1.0, doc="speed; 0 is as fast as the acknowledgements allow", unit="x", low=0.0, high=100.0)
    topics: tuple[str, ...] = setting((), doc="topics of the bag to play; empty plays all")
    image_topic: str = setting("camera/image_raw", doc="the images that the graph answers")
    acknowledge_topics: tuple[str, ...] = setting(
        (), doc="'NAME TYPE' of topics that bring one message, with the image's stamp, for each image"
    )
    window: int = setting(8, doc="images that may be unanswered at a time", unit="images", low=1, high=1000)
    acknowledge_timeout_s: float = setting(
        30.0, doc="longest wait for an answer before the player gives up", unit="s", low=0.1, high=3600.0
    )
    wait_for_matched: tuple[str, ...] = setting(
        (),
        doc="'NAME COUNT [NODE ...]': subscriptions that a topic must have before anything is played, beside those of "
        "nodes that are not named, if some are",
    )
    match_timeout_s: float = setting(30.0, doc="longest wait for the subscriptions", unit="s", low=0.1, high=3600.0)
    start_delay_s: float = setting(0.0, doc="pause before the first message", unit="s", low=0.0, high=3600.0)
    linger_s: float = setting(
        1.0, doc="pause after the last message, for what is under way", unit="s", low=0.0, high=3600.0
    )
    queue_depth: int = setting(
        100, doc="messages of a topic kept for slow receivers", unit="messages", low=1, high=10000
    )


class PlayerNode(Node):
    """Publishes the topics of the bag `bag`, and `/clock` from its log times; ends after the last message."""

    def __init__(self) -> None:
        super().__init__("player_node")
        self._settings = s = declare(self, PlayerSettings)
        self._diagnostics = Diagnostics(self)
        answers = [entry for entry in s.acknowledge_topics if entry]
        self._answers = Answers(self, answers, s.acknowledge_timeout_s, s.queue_depth)
        self._bag = BagReader(declare_path(self, "bag", "the bag to play: a directory or a .mcap file"))
        chosen = [name for name in s.topics if name]
        self._topics = PlayedTopics(self, self._diagnostics, self._bag, chosen, s.queue_depth)
        self._needed = [self._parse_needed(entry) for entry in s.wait_for_matched if entry]

    def work(self) -> Iterator[float]:
        """Play the bag from its first message to the last answer."""
        yield from self._wait_for_connections()
        yield from self._pause(self._settings.start_delay_s)
        yield from self._play()
        self._topics.end_clock()
        yield from self._answers.wait(0)
        yield from self._pause(self._settings.linger_s)
        for publisher in self._topics.publishers:
            self.get_logger().info(f"published {publisher.sent} on {publisher.topic}")

    def close(self) -> None:
        self._bag.close()

    def _play(self) -> Iterator[float]:
        rate, first_ns = self._settings.rate, self._bag.start_ns
        image_topic = self._settings.image_topic.lstrip("/")
        started = said = time.monotonic()
        for topic, _, log_time_ns, data in self._bag.raw_messages(self._topics.in_bag):
            played_s = (log_time_ns - first_ns) / 1e9
            while rate > 0 and (remaining_s := started + played_s / rate - time.monotonic()) > 0:
                yield remaining_s
            if topic.lstrip("/") == image_topic:
                before = time.monotonic()
                yield from self._answers.wait(self._settings.window - 1)
                started += time.monotonic() - before
                self._answers.in_flight.sent(header_stamp_ns(data))
            self._topics.publish(topic, log_time_ns, data)
            if time.monotonic() > said + 1.0:
                said += 1.0
                self._say_progress(played_s)
            yield 0.0

    def _say_progress(self, played_s: float) -> None:
        total_s = (self._bag.end_ns - self._bag.start_ns) / 1e9
        waiting = self._answers.in_flight
        self.get_logger().info(
            f"{played_s:.1f} of {total_s:.1f} s; {waiting.answered} images answered, {len(waiting)} in flight"
        )

    def _wait_for_connections(self) -> Iterator[float]:
        give_up = time.monotonic() + self._settings.match_timeout_s
        while missing := self._missing_connections():
            if time.monotonic() > give_up:
                raise RgbdDicError(
                    f"not connected within {self._settings.match_timeout_s:g} s: {'; '.join(missing)}. "
                    "Are these nodes running, in the same namespace and ROS domain?"
                )
            yield from self._pause(STEP_S)

    def _missing_connections(self) -> list[str]:
        counts = [
            (publisher, count + (strangers(self, self.get_name(), publisher.topic, nodes) if nodes else 0))
            for publisher, count, nodes in self._needed
        ]
        return [
            f"{publisher.topic} has {publisher.matched} of {count} subscriptions"
            for publisher, count in counts
            if publisher.matched < count
        ] + [f"{topic} has no publisher" for topic in self._answers.without_publisher()]

    def _parse_needed(self, entry: str) -> tuple[WatchedPublisher, int, list[str]]:
        name, count, *nodes = [*entry.split(), "", ""][: max(2, len(entry.split()))]
        if not count.isdecimal():
            raise SettingsError(f"wait_for_matched: '{entry}' is not understood; give 'NAME COUNT [NODE ...]'")
        return self._topics.publisher(name), int(count), nodes

    def _pause(self, duration_s: float) -> Iterator[float]:
        end = time.monotonic() + duration_s
        while (remaining_s := end - time.monotonic()) > 0:
            self._topics.publish_clock()
            yield min(STEP_S, remaining_s)


def main(args: Sequence[str] | None = None) -> int:
    return run(PlayerNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
