"""How a delay is sought."""

from __future__ import annotations

from dataclasses import dataclass

from rgbd_dic_acquisition.errors import SettingsError
from rgbd_dic_acquisition.settings import Settings, setting


@dataclass(frozen=True)
class AlignmentSettings(Settings):
    """Which shifts are tried, and which the second-order curve is fitted to."""

    lowest_s: float = setting(-1.0, unit="s", doc="lowest shift that is tried; positive: the reference is late")
    highest_s: float = setting(1.0, unit="s", doc="highest shift that is tried")
    step_s: float = setting(0.01, unit="s", low=1e-5, high=10.0, doc="from one shift to the next (thesis 4.4.2)")
    fit_s: float = setting(
        0.1, unit="s", low=1e-4, high=100.0, doc="shifts up to so far on either side of the peak are fitted"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.highest_s - self.lowest_s < 2 * self.fit_s:
            raise SettingsError(
                f"shifts from {self.lowest_s:g} to {self.highest_s:g} s: the second must be above the first by at "
                f"least {2 * self.fit_s:g} s, the width of the fit"
            )
        if self.fit_s < 2 * self.step_s:
            raise SettingsError(f"fit_s {self.fit_s:g} s must be at least two steps of {self.step_s:g} s")
