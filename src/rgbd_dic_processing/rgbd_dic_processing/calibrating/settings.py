"""What is estimated, and what the images must show for it."""

from __future__ import annotations

from dataclasses import dataclass

from rgbd_dic_acquisition.settings import Settings, setting


@dataclass(frozen=True)
class CalibratingSettings(Settings):
    """Model of the sensors, choice of images, and the least that they must show."""

    principal_point: str = setting("centre", choices=("centre", "free"), doc="middle of the image, or estimated")
    tof_distortion: bool = setting(False, doc="estimate k1, k2 of the ToF sensor too; its maker says that it has none")
    every_s: float = setting(
        0.25, unit="s", low=0.0, high=60.0, doc="time between the ToF frames that are taken of a bag"
    )
    moving_px: float = setting(
        0.3,
        unit="px",
        low=0.0,
        high=100.0,
        doc="largest shift of the board, in the camera, between its two exposures in a bag",
    )
    most_views: int = setting(60, low=8, high=1000, doc="boards that are used; of more, the most different ones")
    alike: float = setting(0.003, low=0.0, high=0.1, doc="boards whose corners differ less are one; part of the width")
    blurred: float = setting(3.0, low=1.0, high=100.0, doc="edges wider than so many median ones are blurred")
    least_boards: int = setting(8, low=4, high=1000, doc="boards that each sensor must see")
    least_pairs: int = setting(5, low=3, high=1000, doc="boards that both sensors must see at once")
    least_tilt_rad: float = setting(
        0.12, unit="rad", low=0.0, high=1.0, doc="tilt that must be reached about both axes, to both sides"
    )
    covered: float = setting(0.3, low=0.0, high=1.0, doc="part of each quarter of an image that boards must cover")
    covered_undistorted: float = setting(
        0.02, low=0.0, high=1.0, doc="the same for a sensor whose distortion is not estimated"
    )
    misfit: float = setting(5.0, low=1.0, high=1e3, doc="boards that fit so many times worse than usual are left out")
    mispaired_m: float = setting(
        0.05, unit="m", low=0.0, high=10.0, doc="boards that are farther apart in both sensors are no pair"
    )
    mispaired_rad: float = setting(0.1, unit="rad", low=0.0, high=1.0, doc="the same for their turn")
    worst_focal: float = setting(0.01, low=0.0, high=1.0, doc="largest relative uncertainty of a focal length")
    scale_error: float = setting(
        0.03, low=0.0, high=1.0, doc="largest relative difference of the ToF sensor's depth from the boards'"
    )
