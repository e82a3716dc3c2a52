"""What a node says of the uncertainty of its stamps."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from rgbd_dic_acquisition.nodes import diagnostics as module
from rgbd_dic_acquisition.nodes.diagnostics import STAMPS, Diagnostics


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch):
    """(Diagnostics, what it has said of the stamps). A status may follow another at once."""
    monkeypatch.setattr(module, "SOONEST_S", 0.0)
    heard: list[str | None] = []

    def take(message) -> None:
        heard.append(next((pair.value for pair in message.status[0].values if pair.key == STAMPS), None))

    clock = SimpleNamespace(now=lambda: SimpleNamespace(to_msg=Time))
    node = SimpleNamespace(
        get_fully_qualified_name=lambda: "/node",
        create_publisher=lambda *_: SimpleNamespace(publish=take),
        create_timer=lambda *_, **__: None,
        get_clock=lambda: clock,
    )
    return Diagnostics(node), heard


def test_a_status_has_the_largest_since_the_one_before(said):
    diagnostics, heard = said
    diagnostics._publish()
    for uncertainty_ns in (1e5, 3e6, 2e5):
        diagnostics.tell_stamp(uncertainty_ns)
    diagnostics._publish()
    diagnostics.tell_stamp(1e5)
    diagnostics._publish()
    diagnostics._publish()
    assert heard == [None, "3.000", "0.100", "0.100"], "without a stamp in between it stays"


def test_that_it_is_known_now_is_said_at_once(said):
    """So that the stamps from then on are not hidden behind the infinity of those before."""
    diagnostics, heard = said
    diagnostics.tell_stamp(math.inf)
    diagnostics.ok()
    assert heard == []
    diagnostics.tell_stamp(1e5)
    diagnostics.ok()
    diagnostics.tell_stamp(2e5)
    diagnostics.ok()
    diagnostics._publish()
    assert heard == ["inf", "0.200"]
