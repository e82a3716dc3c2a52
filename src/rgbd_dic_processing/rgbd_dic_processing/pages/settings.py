"""Settings of the live page."""

from __future__ import annotations

from dataclasses import dataclass

from rgbd_dic_acquisition.settings import Settings, setting


@dataclass(frozen=True)
class OperatorSettings(Settings):
    """The live page: where it is served, and what it may cost."""

    host: str = setting("127.0.0.1", doc="address to listen on; any but the loopback asks for a token")
    port: int = setting(8420, low=0, high=65535, doc="port to listen on; 0 takes a free one")
    picture_quality: int = setting(60, low=5, high=100, doc="of the pictures as JPEG; 100 is the best")
    most_viewers: int = setting(8, low=1, high=100, doc="viewers that are served at a time; more are refused")
    linger_s: float = setting(
        2.0,
        unit="s",
        low=0.5,
        high=600.0,
        doc="how long the topics are still heard after the last word of a viewer, who says one with each portion of "
        "numbers",
    )
    noise: float = setting(
        1.0,
        unit="grey levels",
        low=0.01,
        high=255.0,
        doc="noise of the camera's pixels, for the uncertainty that the regions page expects",
    )
