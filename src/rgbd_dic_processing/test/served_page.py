"""The live page's server without a graph, for tests: what it tells is put in by hand."""

from __future__ import annotations

import math
import time
import urllib.error
import urllib.request

import aiohttp
import numpy as np
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.opening_log import Openings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.pages.access import Access
from rgbd_dic_processing.pages.live_page import LivePage
from rgbd_dic_processing.pages.live_state import LiveState
from rgbd_dic_processing.pages.server import ServerThread, make_app

START_NS = 1_750_000_000_000_000_000


def opening(time_s: float, value_m: float) -> CrackOpening:
    """An opening at a time since the start; NaN is one that is not valid."""
    valid = math.isfinite(value_m)
    return CrackOpening(
        START_NS + round(time_s * 1e9),
        START_NS,
        "h_pose",
        FrameStatus.OK if valid else FrameStatus.LOST,
        "" if valid else "the reference pattern was not found in the image",
        *(value_m, 0.0 if valid else math.nan, math.nan, abs(value_m)),
        *(2e-6 if valid else math.nan, 2e-6 if valid else math.nan, math.nan, math.nan),
        *(70, 71, 0.002),
    )


class Served:
    """The live page in a thread, on a free port of the loopback."""

    def __init__(self, token: str | None = None, most_viewers: int = 4):
        self.state = LiveState(most_viewers)
        access = Access("127.0.0.1", 0, token)
        told: list[str] = []
        self.thread = ServerThread(make_app(access, LivePage(self.state).routes(), "/live"), access, told.append)
        deadline = time.monotonic() + 10
        while not told and time.monotonic() < deadline:
            self.thread.check()
            time.sleep(0.01)
        self.address = told[0].split("?")[0]
        self.port = int(self.address.rstrip("/").rsplit(":", 1)[1])

    def ask(self, path: str, data: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        """Status and body of an answer; redirections are not followed."""
        request = urllib.request.Request(self.address + path.lstrip("/"), data, headers)
        opener = urllib.request.build_opener(NoRedirection)
        try:
            with opener.open(request, timeout=10) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()


async def portion(viewer: aiohttp.ClientWebSocketResponse) -> dict:
    """The next portion of the numbers, acknowledged as the page does."""
    content = await viewer.receive_json(timeout=5)
    await viewer.send_str("")
    return content


class NoRedirection(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: object) -> None:
        return None


def openings(times_s: list[float], value_m: float) -> Openings:
    """The same valid opening at each of these times since the start."""
    stamps_ns = START_NS + np.round(np.array(times_s) * 1e9).astype(np.int64)
    return Openings(stamps_ns, np.full(len(times_s), value_m, np.float32), np.full(len(times_s), 2e-6, np.float32))
