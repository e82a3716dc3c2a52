"""Bytes that come as an image and are none, as from a damaged bag that is played: counted, and the node lives on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.node import Node
from rgbd_dic_processing.nodes import dic_node, plane_node
from rgbd_dic_processing.nodes.keeping_up import KeepUp

SAMPLE = Path(__file__).parents[3] / "bags" / "sample"
UNREADABLE = (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + bytes(20), b"\xff" * 200)


@pytest.mark.parametrize("kind", [dic_node.DicNode, plane_node.PlaneNode])
def test_what_is_no_image_is_counted(kind: Callable[..., Node], monkeypatch: pytest.MonkeyPatch) -> None:
    taken = {}

    def subscribe(self, message, topic, callback, qos, left_out=lambda _: None, raw=False) -> None:
        taken.update(callback=callback, left_out=left_out, raw=raw)

    monkeypatch.setattr(KeepUp, "subscribe", subscribe)
    files = {"regions_file": SAMPLE / "regions.yaml", "calibration_file": SAMPLE / "calibration.yaml"}
    arguments = [word for name, path in files.items() for word in ("-p", f"{name}:={path}")]
    context = rclpy.Context()
    rclpy.init(context=context, args=["--ros-args", *arguments], domain_id=94)
    node = kind(context=context)
    counted = []
    monkeypatch.setattr(node, "diagnostics", SimpleNamespace(count=counted.append, warn=lambda _: None))
    try:
        assert taken["raw"]
        for serialised in UNREADABLE:
            taken["callback"](serialised)
            taken["left_out"](serialised)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    assert counted == ["unreadable"] * len(UNREADABLE)
