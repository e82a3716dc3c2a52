"""Whether somebody takes what a node publishes, or has gone without a word."""

from __future__ import annotations

import time

from rgbd_dic_acquisition.nodes.diagnostics import WatchedPublisher

GONE_S = 1.5


class Attended:
    """Of a reliable publisher. A viewer that crashed or lost its connection stays matched until its lease of twenty
    seconds or so is over. If it is the only one, it is taken as gone as soon as it confirms nothing for a while; when
    it confirms after all, or another one comes, it goes on. Best-effort viewers confirm nothing and count as there.

    Only for topics that rest between two messages for longer than a confirmation is under way.
    """

    def __init__(self, output: WatchedPublisher):
        self._output, self._matched, self._confirmed_s = output, 0, 0.0

    def now(self) -> bool:
        """To be asked several times a second."""
        matched = self._output.matched
        if matched != self._matched or (matched == 1 and self._output.confirmed()):
            self._matched, self._confirmed_s = matched, time.monotonic()
        return matched > 1 or (matched == 1 and time.monotonic() - self._confirmed_s < GONE_S)
