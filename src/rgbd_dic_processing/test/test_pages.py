"""The pages' server without a graph: who gets in, many viewers, lost ones, hostile requests, the record of a flight."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import aiohttp
import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.errors import RgbdDicError, SettingsError
from rgbd_dic_processing.pages.access import Access, is_loopback
from rgbd_dic_processing.pages.flight_record import FlightRecord
from rgbd_dic_processing.pages.live_state import Picture
from rgbd_dic_processing.pages.server import ServerThread, make_app
from served_page import START_NS, NoRedirection, Served, opening, openings, portion

TOKEN = "a-token-of-the-test"


@pytest.fixture
def served() -> Iterator[Served]:
    server = Served(None)
    yield server
    server.thread.close()


@pytest.fixture
def guarded() -> Iterator[Served]:
    server = Served(TOKEN)
    yield server
    server.thread.close()


def test_only_the_loopback_needs_no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(is_loopback(host) for host in ("127.0.0.1", "127.8.8.8", "localhost", "::1"))
    assert not any(is_loopback(host) for host in ("0.0.0.0", "192.168.1.2", "drone.local", "", "::"))
    assert Access.on("127.0.0.1", 80).token is None
    monkeypatch.delenv("RGBD_DIC_TOKEN", raising=False)
    tokens = {Access.on("0.0.0.0", 80).token for _ in range(3)}
    assert len(tokens) == 3 and all(len(token) >= 20 for token in tokens)
    monkeypatch.setenv("RGBD_DIC_TOKEN", "short")
    with pytest.raises(SettingsError, match="at least 12"):
        Access.on("0.0.0.0", 80)


def test_a_token_is_asked_for_and_kept_in_a_cookie(guarded: Served) -> None:
    assert guarded.ask("/live")[0] == 401
    assert guarded.ask("/live?token=another-token-of-it")[0] == 401
    assert guarded.ask("/live/event", b'{"text": "x"}', **{"Content-Type": "application/json"})[0] == 401
    request = urllib.request.Request(f"{guarded.address}live?token={TOKEN}")
    with pytest.raises(urllib.error.HTTPError) as answer:
        urllib.request.build_opener(NoRedirection).open(request, timeout=10)
    cookie = answer.value.headers["Set-Cookie"]
    assert answer.value.code == 302 and answer.value.headers["Location"] == "/live"
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert guarded.ask("/live", Cookie=cookie.split(";")[0])[0] == 200


@pytest.mark.parametrize(
    "path, data, headers, status",
    [
        ("/live", None, {"Host": "evil.example"}, 403),  # a name that was made to resolve to this computer
        ("/live/event", b'{"text": "x"}', {"Origin": "http://evil.example", "Content-Type": "application/json"}, 403),
        ("/live/event", b"text=x", {"Content-Type": "application/x-www-form-urlencoded"}, 415),
        ("/live/event", b"{", {"Content-Type": "application/json"}, 400),
        ("/live/event", b"[1]", {"Content-Type": "application/json"}, 400),
        ("/live/event", b"[" * 100_000, {"Content-Type": "application/json"}, 400),
        ("/live/event", b'{"text": 5}', {"Content-Type": "application/json"}, 400),
        ("/live/event", json.dumps({"text": "x" * 201}).encode(), {"Content-Type": "application/json"}, 422),
        ("/live/event", b" " * (2 << 20), {"Content-Type": "application/json"}, 413),
        ("/live/recording", b'{"on": "yes"}', {"Content-Type": "application/json"}, 400),
        ("/live/picture?after=x", None, {}, 400),
        ("/live/picture?after=0&coarse=99", None, {}, 400),
        ("/static/../server.py", None, {}, 404),
        ("/static/%2e%2e/server.py", None, {}, 404),
        ("/live/numbers", None, {"Origin": "http://evil.example"}, 403),
        ("/live/numbers", None, {}, 400),  # not a WebSocket
    ],
)
def test_hostile_requests_are_refused(served: Served, path: str, data: bytes, headers: dict, status: int) -> None:
    assert served.ask(path, data, **headers)[0] == status
    assert served.ask("/live")[0] == 200


def test_answers_carry_the_headers_that_keep_a_browser_safe(served: Served) -> None:
    with urllib.request.urlopen(f"{served.address}live", timeout=10) as answer:
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_viewers_see_the_same_and_too_many_are_refused(served: Served) -> None:
    """Four look, a fifth is told that it is too many; one leaves without a word, and its place is free again."""
    values = np.linspace(0, 1e-3, 50)
    for index, value in enumerate(values):
        served.state.add_opening(opening(index / 60, value))

    async def look() -> None:
        async with aiohttp.ClientSession() as session:
            address = f"{served.address}live/numbers"
            viewers = [await session.ws_connect(address) for _ in range(4)]
            firsts = [await portion(viewer) for viewer in viewers]
            assert all(first["last"]["opening_mm"] == pytest.approx(1.0) for first in firsts)
            assert all([s[1] for s in first["samples"]] == pytest.approx(1e3 * values, abs=1e-6) for first in firsts)
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await session.ws_connect(address)
            assert refused.value.status == 503
            viewers[0]._response.connection.transport.abort()
            for _ in range(100):
                await asyncio.sleep(0.05)
                if served.state.surroundings()["viewers"] == 3:
                    break
            late = await session.ws_connect(address)
            assert (await portion(late))["last"]["opening_mm"] == pytest.approx(1.0)
            served.state.add_opening(opening(1.0, 2e-3))
            while not (news := await portion(viewers[1]))["samples"]:
                pass
            assert news["samples"][0][1] == pytest.approx(2.0) and not news["from_start"]
            for viewer in (*viewers[1:], late):
                await viewer.close()

    asyncio.run(look())
    deadline = time.monotonic() + 5
    while served.state.surroundings()["viewers"] and time.monotonic() < deadline:
        time.sleep(0.02)


def test_a_viewer_that_says_nothing_more_is_not_looked_after(served: Served) -> None:
    """Its connection may be lost long before anybody is told; when it goes on after all, it is there again."""
    assert not served.state.watched(linger_s=0.5)

    async def look() -> None:
        async with aiohttp.ClientSession() as session:
            viewer = await session.ws_connect(f"{served.address}live/numbers")
            await viewer.receive_json()
            assert served.state.watched(linger_s=0.5)
            await asyncio.sleep(0.6)
            assert served.state.surroundings()["viewers"] == 1
            assert not served.state.watched(linger_s=0.5)
            await viewer.send_str("")
            await viewer.receive_json()
            assert served.state.watched(linger_s=0.5)
            await viewer.close()

    asyncio.run(look())


def test_a_viewer_that_reads_nothing_holds_nobody_up(served: Served) -> None:
    """It fills its socket and stops; the openings of the others go on."""
    silent = socket.create_connection(("127.0.0.1", served.port))
    silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    silent.sendall(
        f"GET /live/numbers HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    served.state.add_opening(opening(0.0, 0.0))
    feeding = threading.Event()

    def feed() -> None:
        index = 0
        while not feeding.wait(0.002):
            index += 1
            served.state.add_opening(opening(index * 0.01, 1e-6 * index))

    thread = threading.Thread(target=feed)
    thread.start()

    async def look() -> list[float]:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{served.address}live/numbers") as viewer:
            return [(await portion(viewer))["last"]["time"] for _ in range(8)]

    try:
        times = asyncio.run(look())
    finally:
        feeding.set()
        thread.join()
        silent.close()
    assert all(later > earlier for earlier, later in pairwise(times))


def test_nothing_piles_up_on_a_slow_link(served: Served) -> None:
    """What is not acknowledged is all that is under way; the next portion has the newest opening and all between."""

    async def look() -> None:
        served.state.add_opening(opening(0.0, 0.0))
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{served.address}live/numbers") as viewer:
            assert (await viewer.receive_json(timeout=5))["last"]["time"] == 0.0
            for index in range(1, 61):
                served.state.add_opening(opening(index / 10, 1e-6 * index))
            with pytest.raises(asyncio.TimeoutError):
                await viewer.receive_json(timeout=1.0)  # five portions later
            await viewer.send_str("")
            news = await viewer.receive_json(timeout=5)
            assert news["last"]["time"] == 6.0 and len(news["samples"]) == 60 and not news["from_start"]

    asyncio.run(look())


def test_half_requests_hold_nobody_up(served: Served) -> None:
    halves = [socket.create_connection(("127.0.0.1", served.port)) for _ in range(200)]
    for half in halves:
        half.sendall(b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\n")
    assert served.ask("/live")[0] == 200
    for half in halves:
        half.close()
    assert served.ask("/live")[0] == 200


def test_pictures_come_one_by_one(served: Served) -> None:
    assert not served.state.picture_wanted()
    grey = np.tile(np.linspace(20, 200, 40).astype(np.uint8), (30, 1))
    outlines = {"panel": [[[1, 2], [3, 4], [5, 6]]]}
    with served.state.viewer():
        threading.Timer(
            0.3, lambda: served.state.set_picture(Picture(7, START_NS, 80, 60, grey, 90, outlines, ""))
        ).start()
        status, body = served.ask("/live/picture?after=-1")  # it waits until there is one
        about, jpeg = body.split(b"\n", 1)
        seen = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert status == 200 and seen.shape == grey.shape and np.abs(seen.astype(int) - grey).max() < 10
        assert json.loads(about) == {
            **{"number": 7, "stamp_ns": str(START_NS), "width": 80, "height": 60},
            **{"outlines": outlines, "reason": ""},
        }
        assert served.state.picture_wanted()
        for coarse, width in ((0, 40), (1, 20), (2, 10)):
            _, jpeg = served.ask(f"/live/picture?after=-1&coarse={coarse}")[1].split(b"\n", 1)
            assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE).shape[1] == width
    assert not served.state.picture_wanted()  # nobody looks


def test_orders_reach_the_node_and_its_words_the_viewer(served: Served) -> None:
    def node() -> None:
        for answer in ("the next good image becomes the reference", RgbdDicError("dic_node is not running")):
            order = served.state.orders.get(timeout=10)
            assert order.what == "reference"
            order.answer(answer)
            order.answer("too late")

    thread = threading.Thread(target=node)
    thread.start()
    json_type = {"Content-Type": "application/json"}
    assert served.ask("/live/reference", b"{}", **json_type) == (
        200,
        b'{"done":"the next good image becomes the reference"}',
    )
    assert served.ask("/live/reference", b"{}", **json_type) == (422, b'{"error": "dic_node is not running"}')
    thread.join()


def test_a_taken_port_is_told(served: Served) -> None:
    access = Access("127.0.0.1", served.port, None)
    thread = ServerThread(make_app(access, [], "/live"), access, lambda _: None)
    deadline = time.monotonic() + 10
    with pytest.raises(RgbdDicError, match=f"port {served.port}.*another --port"):
        while time.monotonic() < deadline:
            thread.check()
            time.sleep(0.01)
    thread.close()


def test_record_of_a_flight() -> None:
    """Of 100 s with a peak that lasts one image: the minute holds 60 s, the overview keeps the peak and the gap."""
    record = FlightRecord()
    for index in range(1001):
        value = 5e-3 if index == 321 else math.nan if 500 <= index < 600 else 1e-3
        record.add(opening(index / 10, value))
    samples, following = record.since(0, window_s=60.0)
    assert following == 1001 and samples[0][0] == 40.0 and samples[-1][0] == 100.0
    assert samples[100][1:] == [None, None] and samples[-1][1:] == [1.0, 0.002]
    assert record.since(1000, 60.0)[0] == samples[-1:] and record.since(following, 60.0)[0] == []
    overview = record.overview(50)
    assert overview["end"] == 100.0 and overview["high"][16] == 5.0 and overview["low"][16] == 1.0
    assert overview["low"][27] is None and overview["invalid"][27] == 1.0 and sum(overview["invalid"]) == 5.0


def test_a_bag_that_is_played_again_begins_another_flight() -> None:
    record = FlightRecord()
    for time_s in (0.0, 0.1, 0.2, 10.0):
        record.add(opening(time_s, 1e-3))
    record.add(replace(opening(0.0, 2e-3)))
    assert record.flight == 1 and record.since(0, 60.0) == ([[0.0, 2.0, 0.002]], 1)


@pytest.mark.parametrize(
    "known_s, there",
    [
        ([0.0, 1.0, 2.0, 3.0], [(0.0, 5.0), (1.0, 5.0), (2.0, 5.0), (3.0, 5.0), (4.0, 1.0)]),  # 4 s came meanwhile
        ([3.5], [(0.0, 1.0), (1.0, 1.0), (1.5, 5.0), (2.0, 1.0)]),  # of a node that was started anew
        ([], [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]),
        ([0.0, 0.5], [(0.0, 5.0), (0.5, 5.0)]),  # of a bag that is played again: what was here is of another flight
    ],
)
def test_what_was_measured_unheard_is_put_into_its_place(known_s: list[float], there: list) -> None:
    record = FlightRecord()
    for time_s in (2.0, 3.0, 4.0):
        record.add(opening(time_s, 1e-3))
    record.fill(openings(known_s, 5e-3))
    samples, following = record.since(0, 60.0)
    assert [(time_s, value) for time_s, value, _ in samples] == there and following == len(there)
    assert record.flight == (1 if known_s else 0) and record.time_s(START_NS) == (-2.0 if there[0] == (0.0, 1.0) else 0)


def test_the_log_of_a_very_long_flight_forgets_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rgbd_dic_processing.core.opening_log.MOST", 10)
    record = FlightRecord()
    for index in range(11):
        record.add(opening(index, 1e-3))
    samples, following = record.since(9, 60.0)
    assert following == 11 and [sample[0] for sample in samples] == [9.0, 10.0]
    assert [sample[0] for sample in record.since(0, 60.0)[0]] == [5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
