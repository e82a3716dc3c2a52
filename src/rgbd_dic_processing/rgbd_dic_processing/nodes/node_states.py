"""What the nodes say on /diagnostics, as the live page shows it."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

RATE, AGE, SENT, MATCHED = "rate [1/s]", "age of the last [s]", "messages sent", "matched subscriptions"


def node_states(message: DiagnosticArray, namespace: str) -> dict[str, dict[str, Any]]:
    """Node -> its level ("ok", "warn", "error"), message, counters and topics, from one message of a node.

    Names are without the namespace; nodes of other namespaces are left out. Each topic has its name, its rate [1/s] and
    the age of the last message [s], None if there is none yet.
    """
    prefix = namespace.rstrip("/") + "/"
    states: dict[str, dict[str, Any]] = {}
    for status in message.status:
        node, _, topic = status.name.partition(": ")
        if not node.startswith(prefix):
            continue
        name = node.removeprefix(prefix)
        values = {pair.key: pair.value for pair in status.values}
        state = states.setdefault(name, {"level": "ok", "message": "", "counters": {}, "topics": []})
        if topic:
            state["topics"].append(
                {"name": topic.removeprefix(prefix), "rate": _number(values.get(RATE)), "age": _number(values.get(AGE))}
            )
        else:
            state |= {"level": _level(status.level), "message": status.message, "counters": values}
    return states


def _level(level: bytes | int) -> str:
    value = level[0] if isinstance(level, bytes) else level
    ok, warn = (DiagnosticStatus.OK, DiagnosticStatus.WARN)
    names = {ok[0]: "ok", warn[0]: "warn"}
    return names.get(value, "error")


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "nan")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
