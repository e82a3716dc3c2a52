"""Several nodes in one process, one after another: what one publishes, the others take at once.

    composed_nodes --node dic_node --ros-args ... --node compensation_node --ros-args ...

They stay the nodes that they are, with their names, parameters and topics; others hear them as before.
"""

from __future__ import annotations

import sys

from rclpy.node import Node
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.nodes.diagnostics import WatchedPublisher
from rgbd_dic_acquisition.nodes.spinning import run_together

from .compensation_node import CompensationNode
from .crack_opening_node import CrackOpeningNode
from .dic_node import DicNode
from .pairing_node import PairingNode
from .plane_node import PlaneNode

KINDS = {
    "dic_node": DicNode,
    "pairing_node": PairingNode,
    "plane_node": PlaneNode,
    "compensation_node": CompensationNode,
    "crack_opening_node": CrackOpeningNode,
}
BEGIN = "--node"


def hand_over(nodes: list[Node]) -> None:
    """From now on, what one of these nodes publishes reaches the others by a call, not through the middleware."""
    outputs: dict[str, WatchedPublisher] = {
        output.topic: output for node in nodes for output in node.diagnostics.outputs
    }
    for node in nodes:
        inside: list[Subscription] = [one for one in node.subscriptions if one.topic_name in outputs and not one.raw]
        for subscription in inside:
            outputs[subscription.topic_name].hand_to(subscription.callback)
            node.destroy_subscription(subscription)


def _made(arguments: list[str]) -> list[Node]:
    begins = [index for index, word in enumerate(arguments) if word == BEGIN]
    groups = [arguments[begin + 1 : end] for begin, end in zip(begins, [*begins[1:], None], strict=True)]
    wrong = [group for group in groups if not group or group[0] not in KINDS]
    if not groups or wrong:
        raise RgbdDicError(f"expected {BEGIN} and one of {', '.join(KINDS)}, then its arguments; got {arguments}")
    nodes = [KINDS[name](cli_args=rest) for name, *rest in groups]
    hand_over(nodes)
    return nodes


def main() -> int:
    return run_together(lambda: _made(sys.argv[1:]), args=[])
