"""The page of a running graph: numbers through a WebSocket, pictures one by one as fast as they are fetched."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time

from aiohttp import WSMsgType, web
from rgbd_dic_acquisition.errors import RgbdDicError

from .live_state import COARSEST, LiveState, TooManyViewers
from .server import json_request, json_response, page

PERIOD_S, SLOW_S = 0.2, 1.0  # of the numbers, and of what changes slowly
PICTURE_TIMEOUT_S = 5.0
ALIVE_S = 10.0  # a viewer that does not answer a ping in this time is gone
LONGEST_EVENT = 200  # characters


class LivePage:
    """Serves the page, and `live/...` for it."""

    def __init__(self, state: LiveState):
        self._state = state

    def routes(self) -> list[web.AbstractRouteDef]:
        return [
            web.get("/live", page("live.html")),
            web.get("/live/numbers", self._numbers),
            web.get("/live/picture", self._picture),
            web.post("/live/reference", self._reference),
            web.post("/live/recording", self._recording),
            web.post("/live/event", self._event),
        ]

    async def _numbers(self, request: web.Request) -> web.StreamResponse:
        """The openings as they come; a viewer that leaves, or says nothing for long, is let go."""
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(self._state.viewer())
            except TooManyViewers as error:
                raise web.HTTPServiceUnavailable(text=str(error)) from error
            socket = web.WebSocketResponse(heartbeat=ALIVE_S, max_msg_size=1024)
            await socket.prepare(request)
            with contextlib.suppress(ConnectionError, RuntimeError):  # it went away
                await self._tell(socket)
            await socket.close()
        return socket

    async def _tell(self, socket: web.WebSocketResponse) -> None:
        """The next portion goes out when the viewer has said that it has the one before: nothing piles up on a slow
        link, whose portions are fewer and larger, and as new as the others."""
        flight, number, slow_at = -1, 0, float("-inf")
        while not socket.closed:
            content, flight, number = self._state.news(flight, number)
            if time.monotonic() - slow_at >= SLOW_S:
                slow_at = time.monotonic()
                content |= self._state.surroundings()
            await socket.send_str(json.dumps(content, allow_nan=False, separators=(",", ":")))
            said, _ = await asyncio.gather(socket.receive(), asyncio.sleep(PERIOD_S))
            if said.type is not WSMsgType.TEXT:
                return
            self._state.hear_viewer()

    async def _picture(self, request: web.Request) -> web.Response:
        """The next picture after the one that the viewer has, as a line of JSON and a JPEG; 204 if none comes.

        `coarse` is for a slow link: so many times the picture is halved.
        """
        try:
            after, coarse = (int(request.query.get(name, default)) for name, default in (("after", -1), ("coarse", 0)))
            if coarse not in range(COARSEST + 1):
                raise ValueError(f"coarse is {coarse}")
        except ValueError as error:
            raise web.HTTPBadRequest(text=f"after: the number of a picture; coarse: 0 to {COARSEST}") from error
        picture = await self._state.next_picture(after, PICTURE_TIMEOUT_S)
        if picture is None:
            return web.Response(status=204)
        about = {
            "number": picture.number,
            "stamp_ns": str(picture.stamp_ns),
            "width": picture.width,
            "height": picture.height,
            "outlines": picture.outlines,
            "reason": picture.reason,
        }
        words = json.dumps(about, allow_nan=False).encode()
        return web.Response(body=words + b"\n" + picture.jpeg(coarse), content_type="application/octet-stream")

    async def _reference(self, _: web.Request) -> web.Response:
        return json_response({"done": await self._state.order("reference")})

    async def _recording(self, request: web.Request) -> web.Response:
        wanted = (await json_request(request)).get("on")
        if not isinstance(wanted, bool):
            raise web.HTTPBadRequest(text="on: expected true or false")
        return json_response({"done": await self._state.order("recording", wanted)})

    async def _event(self, request: web.Request) -> web.Response:
        text = (await json_request(request)).get("text")
        if not isinstance(text, str):
            raise web.HTTPBadRequest(text="text: expected words")
        words = " ".join(text.split())
        if len(words) > LONGEST_EVENT:
            raise RgbdDicError(f"an event of {len(words)} characters: use at most {LONGEST_EVENT}")
        return json_response({"done": await self._state.order("event", words or "mark")})
