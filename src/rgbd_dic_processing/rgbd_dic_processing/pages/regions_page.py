"""The page on which regions are drawn: what it asks the server for."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from aiohttp import web
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RegionsError

from ..core.preview import POOR_PX
from ..core.regions_file import entries_of_text, known_entries, write_entries
from .drawing import Drawing, Look
from .server import json_request, json_response, page

HEADING = "Drawn on the image of stamp {stamp} ns of {name}; in pixels of that image (docs/files.md)."


class Live(Protocol):
    """A running graph that takes regions."""

    async def drawing(self) -> tuple[Drawing, dict[str, Any]]:
        """The latest image, to be drawn on, and the entries of the regions in force there; none if not known."""

    async def set_regions(self, entries: Mapping[str, Any], drawing: Drawing) -> str:
        """Measure by these regions from now on, from the image that they were drawn on; returns what was done."""


class RegionsPage:
    """Serves the page, `regions/...` for it, and writes what was drawn.

    Args:
        drawing: what to draw on; None until a live graph has been asked for an image.
        out: the file that is written.
        start: entries of a regions.yaml to begin with.
        live: the running graph, if there is one.
    """

    def __init__(self, drawing: Drawing | None, out: Path, start: Mapping[str, Any], live: Live | None = None):
        self._drawing, self._out, self._start, self._live = drawing, out, dict(start), live
        self._fetching = asyncio.Lock()

    def routes(self) -> list[web.AbstractRouteDef]:
        return [
            web.get("/regions", page("regions.html")),
            web.get("/regions/scene", self._scene),
            web.get("/regions/image", self._image),
            web.post("/regions/look", self._look),
            web.post("/regions/read", self._read),
            web.post("/regions/save", self._save),
            web.post("/regions/new_image", self._new_image),
            web.post("/regions/set", self._set),
        ]

    async def _scene(self, _: web.Request) -> web.Response:
        """What there is to draw on, and what has been drawn already."""
        drawing = await self._current()
        rows, cols = drawing.image.shape
        correlation = drawing.settings.correlation
        return json_response(
            {
                "name": drawing.name,
                "stamp_ns": str(drawing.stamp_ns),
                "width": cols,
                "height": rows,
                "subset_size": correlation.subset_size,
                "step": correlation.step,
                "noise": drawing.noise,
                "poor_px": POOR_PX,
                "out": str(self._out),
                "live": self._live is not None,
                "entries": self._start,
            }
        )

    async def _image(self, _: web.Request) -> web.Response:
        drawing = await self._current()
        encoded = await asyncio.to_thread(_png, drawing.image)
        return web.Response(body=encoded, content_type="image/png")

    async def _look(self, request: web.Request) -> web.Response:
        """What the regions on the page come to."""
        drawing = await self._current()
        entries = _entries(await json_request(request))
        return json_response(look_content(await asyncio.to_thread(drawing.look, entries)))

    async def _read(self, request: web.Request) -> web.Response:
        """The entries of a regions.yaml that the user chose on their computer."""
        text = (await json_request(request)).get("text")
        if not isinstance(text, str):
            raise web.HTTPBadRequest(text="send the text of a file")
        return json_response({"entries": await asyncio.to_thread(entries_of_text, text)})

    async def _save(self, request: web.Request) -> web.Response:
        """Write regions.yaml, if it can work."""
        drawing = await self._current()
        entries = await self._checked(request, drawing)
        replaced = self._out.exists()
        heading = HEADING.format(stamp=drawing.stamp_ns, name=drawing.name)
        await asyncio.to_thread(write_entries, entries, self._out, heading)
        self._start = entries
        return json_response({"done": f"saved {self._out}" + (" in place of the old one" if replaced else "")})

    async def _new_image(self, _: web.Request) -> web.Response:
        """Draw on the latest image of the running graph."""
        self._drawing, self._start = await self._graph().drawing()
        return json_response({"done": "the regions in force are where the motion has carried them"})

    async def _set(self, request: web.Request) -> web.Response:
        """Have the running graph measure by what is drawn."""
        drawing = await self._current()
        entries = await self._checked(request, drawing)
        done = await self._graph().set_regions(entries, drawing)
        self._start = entries
        return json_response({"done": done})

    async def _checked(self, request: web.Request, drawing: Drawing) -> dict[str, Any]:
        """The entries of a request, if they can work.

        Raises:
            RegionsError: with every reason why they cannot.
        """
        entries = _entries(await json_request(request))
        look = await asyncio.to_thread(drawing.look, entries)
        if look.preview.refusals:
            raise RegionsError("; ".join(look.preview.refusals))
        return entries

    async def _current(self) -> Drawing:
        async with self._fetching:
            if self._drawing is None:
                self._drawing, in_force = await self._graph().drawing()
                self._start = self._start or in_force
        return self._drawing

    def _graph(self) -> Live:
        if self._live is None:
            raise web.HTTPNotFound(text="there is no running graph here")
        return self._live


def look_content(look: Look) -> dict[str, Any]:
    """A look as JSON: lengths on the panel in mm, and for each subset its place, its zone and its sigma [px]."""
    seen, crack = look.preview, look.regions.crack
    zone = np.select([seen.left, seen.right, seen.fixed], [2, 3, 1], 0)
    pixel_m = look.sizes_m.get("pixel across the crack", math.nan)
    members = {"panel": np.ones(len(zone), bool), "fixed": seen.fixed, "left": seen.left, "right": seen.right}
    textured = np.isfinite(seen.sigma_px).all(axis=1)
    sigma = np.round(seen.sigma_px.max(axis=1, initial=0).astype(float), 5)
    return {
        "refusals": seen.refusals,
        "warnings": seen.warnings,
        "subsets": {
            "x": seen.centres_px[:, 0].tolist(),
            "y": seen.centres_px[:, 1].tolist(),
            "sigma": [value if ok else None for value, ok in zip(sigma.tolist(), textured.tolist(), strict=True)],
            "zone": zone.tolist(),
        },
        "counts": {name: [int(mask.sum()), int((mask & textured).sum())] for name, mask in members.items()},
        "sizes_mm": {name: _number(value * 1e3) for name, value in look.sizes_m.items()},
        "no_sizes": look.no_sizes,
        "u_opening_px": _number(seen.u_opening_px),
        "u_opening_mm": _number(seen.u_opening_px * pixel_m * 1e3),
        "crack": None
        if crack is None
        else {
            "left": crack.left.tolist(),
            "right": crack.right.tolist(),
            "point": crack.point.tolist(),
            "direction": crack.direction.tolist(),
        },
    }


def _entries(content: dict[str, Any]) -> dict[str, Any]:
    entries = content.get("entries")
    if not isinstance(entries, dict):
        raise web.HTTPBadRequest(text="send the entries of a regions.yaml")
    return known_entries(entries, "regions")


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _png(image: NDArray[np.uint8]) -> bytes:
    fastest = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    return cv2.imencode(".png", image, fastest)[1].tobytes()
