"""What the uncertainty of an opening is made of. Values as in rgbd_dic_msgs/DisplacementField."""

from enum import IntEnum


class ErrorSource(IntEnum):
    """A part of the variance; those from MOTION to SHAPE are also sources of the compensation's modes.

    SUBSETS: noise of the DIC in the two measuring zones, the way to the keyframe, and the misfit.
    MOTION: the same in the fixed region, by way of the estimated motion.
    OVERLAP: twice the covariance of these two; negative where the same noise takes part of itself away.
    REFERENCE_PLANE: of the panel in the reference. FRAME_PLANE: of the panel in the image (h_3d, pc_3d; h_joint: of how
    it moved since the reference).
    DEFORMATION: of the fixed region, where it is not told apart from motion (h_joint: and from the plane and the
    curvature of the panel, which it estimates along), or taken for it (h_3d, pc_3d).
    SHAPE: how the panel is curved. SCALE: of all lengths, from the distance of the reference plane.
    """

    SUBSETS = 0
    MOTION = 1
    OVERLAP = 2
    REFERENCE_PLANE = 3
    FRAME_PLANE = 4
    DEFORMATION = 5
    SHAPE = 6
    SCALE = 7
