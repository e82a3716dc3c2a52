"""Bags: MCAP files with the ros2 profile and metadata.yaml, as `ros2 bag` and Foxglove open them."""

from .bag_reader import BagReader, TopicInfo
from .bag_writer import BagWriter
from .message_types import make_message, typestore

__all__ = ["BagReader", "BagWriter", "TopicInfo", "make_message", "typestore"]
