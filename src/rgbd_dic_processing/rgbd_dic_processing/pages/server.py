"""The server of the operator's pages."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import signal
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from aiohttp import web
from rgbd_dic_acquisition.errors import RgbdDicError

from .access import HEADERS, Access, Handler

STATIC = Path(__file__).parent / "static"
LARGEST_REQUEST = 1 << 20  # bytes
log = logging.getLogger(__name__)


def page(name: str) -> Handler:
    """Serves a file of `static/`."""

    async def serve_page(_: web.Request) -> web.StreamResponse:
        return web.FileResponse(STATIC / name)

    return serve_page


def json_response(content: Any) -> web.Response:
    """JSON without NaN, which browsers refuse."""
    return web.json_response(content, dumps=lambda value: json.dumps(value, allow_nan=False, separators=(",", ":")))


async def json_request(request: web.Request) -> dict[str, Any]:
    """The JSON object that a page sent.

    Raises:
        web.HTTPBadRequest: if it is anything else.
    """
    if request.content_type != "application/json":
        raise web.HTTPUnsupportedMediaType(text="send JSON")
    try:
        content = await request.json()
    except (ValueError, RecursionError) as error:
        raise web.HTTPBadRequest(text="this is not JSON") from error
    if not isinstance(content, dict):
        raise web.HTTPBadRequest(text="send a JSON object")
    return content


@web.middleware
async def in_words(request: web.Request, handler: Handler) -> web.StreamResponse:
    """What the user can mend is told in words (422); every answer carries the headers that keep a browser safe."""
    try:
        response = await handler(request)
    except web.HTTPException as error:
        error.headers.update(HEADERS)
        raise
    except RgbdDicError as error:
        response = web.json_response({"error": str(error)}, status=422)
    if not response.prepared:
        response.headers.update(HEADERS)
    return response


def make_app(access: Access, routes: Iterable[web.AbstractRouteDef], start: str) -> web.Application:
    """An application with these routes and the files of `static/`, behind the guard.

    Args:
        start: path that "/" leads to.
    """

    async def to_start(_: web.Request) -> web.StreamResponse:
        raise web.HTTPFound(start)

    app = web.Application(middlewares=[in_words, access.guard], client_max_size=LARGEST_REQUEST)
    app.add_routes([web.get("/", to_start), *routes, web.static("/static", STATIC)])
    return app


class ServerThread:
    """Serves in a thread of its own, beside an executor of ROS."""

    def __init__(self, app: web.Application, access: Access, announce: Callable[[str], None]):
        self._loop, self._until = asyncio.new_event_loop(), asyncio.Event()
        self._failure: RgbdDicError | None = None
        self._thread = threading.Thread(target=self._run, args=(app, access, announce), daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raises: RgbdDicError: if it could not serve."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        with contextlib.suppress(RuntimeError):  # it has ended already
            self._loop.call_soon_threadsafe(self._until.set)
        self._thread.join(timeout=5.0)

    def _run(self, app: web.Application, access: Access, announce: Callable[[str], None]) -> None:
        try:
            self._loop.run_until_complete(serve(app, access, announce, self._until))
        except RgbdDicError as error:
            self._failure = error
        finally:
            self._loop.close()


async def serve(
    app: web.Application, access: Access, announce: Callable[[str], None], until: asyncio.Event | None = None
) -> None:
    """Serve until SIGINT or SIGTERM, or until the event is set.

    Args:
        announce: told the address to open, once the server listens.

    Raises:
        RgbdDicError: if the address cannot be listened on.
    """
    ended = until or asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(ValueError, RuntimeError):  # not in the main thread
            loop.add_signal_handler(number, ended.set)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        try:
            site = web.TCPSite(runner, access.host, access.port)
            await site.start()
        except OSError as error:
            raise RgbdDicError(
                f"cannot listen on {access.host} port {access.port}: {error.strerror}; choose another --port"
            ) from error
        announce(access.address(runner.addresses[0][1]))
        await ended.wait()
    finally:
        await runner.cleanup()
