"""Why a frame cannot be used. Values as in rgbd_dic_msgs/FrameStatus."""

from enum import IntEnum


class FrameStatus(IntEnum):
    OK = 0
    BAD_IMAGE = 1
    LOST = 2
    NO_DEPTH_FRAME = 3
    BAD_DEPTH = 4
    NO_PLANE = 5
    NO_REFERENCE_PLANE = 6
    NO_FIXED_REGION = 7
    NOT_COMPENSATED = 8
    EMPTY_ZONE = 9
