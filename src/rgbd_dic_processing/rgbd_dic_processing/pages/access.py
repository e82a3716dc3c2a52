"""Who may ask the server: this computer alone, or whoever has the token."""

from __future__ import annotations

import hmac
import ipaddress
import os
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

from aiohttp import web
from rgbd_dic_acquisition.errors import SettingsError

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

TOKEN_VARIABLE = "RGBD_DIC_TOKEN"
LEAST_TOKEN = 12  # characters of a token that the user chose
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class Access:
    """The address to listen on, and the token that is asked for; None on the loopback, where nobody else can ask."""

    host: str
    port: int
    token: str | None

    @classmethod
    def on(cls, host: str, port: int) -> Access:
        """A new token, or that of the environment (RGBD_DIC_TOKEN), for an address that others reach.

        Raises:
            SettingsError: if the token of the environment is too short to keep anybody out.
        """
        if is_loopback(host):
            return cls(host, port, None)
        token = os.environ.get(TOKEN_VARIABLE) or secrets.token_urlsafe(16)
        if len(token) < LEAST_TOKEN:
            raise SettingsError(
                f"{TOKEN_VARIABLE} has {len(token)} characters: use at least {LEAST_TOKEN}, or leave it out"
            )
        return cls(host, port, token)

    def address(self, port: int) -> str:
        """What to open in a browser; the port is the one that was given in the end."""
        every = self.host in ("0.0.0.0", "::")
        host = "ADDRESS_OF_THIS_COMPUTER" if every else f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{port}/" + (f"?token={self.token}" if self.token else "")

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse strangers, other sites' pages, and names that merely resolve to this computer."""
        cookie = f"rgbd_dic_{self.port}"
        if self.token is None:
            if not is_loopback(urlsplit(f"//{request.host}").hostname or ""):
                raise web.HTTPForbidden(text=f"{request.host[:100]} is not this computer")
        elif _same(request.query.get("token", ""), self.token):
            response = web.HTTPFound(str(request.rel_url.without_query_params("token")))
            response.set_cookie(cookie, self.token, httponly=True, samesite="Strict")
            raise response
        elif not _same(request.cookies.get(cookie, ""), self.token):
            raise web.HTTPUnauthorized(text="open the address with its token, as rgbd-dic printed it")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text="another site's page may not ask this server")
        return await handler(request)


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches this address or name."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())
