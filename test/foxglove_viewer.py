"""A viewer that speaks Foxglove's websocket protocol, as far as watching topics needs it."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

import aiohttp
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

PROTOCOL = "foxglove.sdk.v1"


@dataclass
class Watched:
    """What came: topic -> (log time [ns], message, its bytes), decoded by what the server said of its schema alone."""

    channels: dict[str, dict[str, Any]] = field(default_factory=dict)
    came: dict[str, list[tuple[int, Any, bytes]]] = field(default_factory=dict)


def watch(
    port: int,
    topics: Collection[str],
    enough: Callable[[Watched], bool],
    timeout_s: float = 60,
    awake: threading.Event | None = None,
    decode: bool = True,
) -> Watched:
    """Subscribe these topics as they are offered, until enough has come or the time is over.

    Args:
        awake: until it is set, nothing is read after the last subscription, as by a viewer on a slow link.
        decode: whether messages are; else they are None.
    """
    return asyncio.run(_watch(port, topics, enough, timeout_s, awake, decode))


async def _watch(
    port: int, topics: Collection[str], enough: Any, timeout_s: float, awake: Any, decode: bool
) -> Watched:
    seen, deadline, ids = Watched(), time.monotonic() + timeout_s, {}
    async with aiohttp.ClientSession() as session:
        socket = await _connect(session, port, deadline)
        while time.monotonic() < deadline and not enough(seen):
            try:
                message = await socket.receive(timeout=0.5)
            except asyncio.TimeoutError:
                continue
            if message.type == aiohttp.WSMsgType.TEXT:
                for channel in _offered(json.loads(message.data)):
                    seen.channels[channel["topic"]] = channel
                    if channel["topic"] in topics:
                        ids[len(ids)] = channel
                        wish = {"id": len(ids) - 1, "channelId": channel["id"]}
                        await asyncio.sleep(0.1)  # foxglove-sdk 0.30 offers a channel shortly before it knows it
                        await socket.send_str(json.dumps({"op": "subscribe", "subscriptions": [wish]}))
                        if awake is not None and len(ids) == len(topics):
                            await asyncio.to_thread(awake.wait, timeout_s)
            elif message.type == aiohttp.WSMsgType.BINARY and message.data[0] == 1:
                subscription, log_time_ns = struct.unpack_from("<IQ", message.data, 1)
                channel, data = ids[subscription], message.data[13:]
                decoded = _decoded(channel, data) if decode else None
                seen.came.setdefault(channel["topic"], []).append((log_time_ns, decoded, data))
            elif message.type in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.ERROR):
                break
        await socket.close()
    return seen


async def _connect(session: aiohttp.ClientSession, port: int, deadline: float) -> aiohttp.ClientWebSocketResponse:
    while True:
        try:
            url = f"ws://127.0.0.1:{port}"
            return await session.ws_connect(url, protocols=(PROTOCOL,), max_msg_size=0)
        except aiohttp.ClientConnectionError:
            if time.monotonic() > deadline:
                raise
            await asyncio.sleep(0.2)


def _offered(content: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for channel in content.get("channels", ()) if content["op"] == "advertise" else ():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        yield channel


def _decoded(channel: dict[str, Any], data: bytes) -> Any:
    if "store" not in channel:
        channel["store"] = get_typestore(Stores.EMPTY)
        channel["store"].register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return channel["store"].deserialize_cdr(data, channel["schemaName"])
