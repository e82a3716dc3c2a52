"""The settings of every stage. YAML groups, ROS parameters and docs/parameters.md come from these fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml
from rgbd_dic_acquisition.errors import SettingsError
from rgbd_dic_acquisition.settings import Settings, setting

from .correlation import CorrelationSettings
from .panel_finding import PanelFindingSettings


@dataclass(frozen=True)
class SearchSettings(Settings):
    """The initial guess of each frame."""

    probes: int = setting(48, unit="subsets", low=40, high=1000, doc="Subsets that test a guess before all are run.")
    min_found: float = setting(
        0.2, low=0.1, high=1.0, doc="Share of the probes that must be found and agree for a guess to be taken."
    )
    max_residual_px: float = setting(
        3.0,
        unit="px",
        low=0.1,
        high=100.0,
        doc="Distance within which a subset agrees with the common homography.",
    )
    rounds: int = setting(
        20, low=0, high=1000, doc="How often subsets that were not found are tried from their neighbours."
    )
    max_missing: float = setting(
        0.1, low=0.0, high=1.0, doc="Share of the subsets that may be missing before the coarse image is asked."
    )
    features: int = setting(1000, unit="features", low=100, high=20000, doc="Features matched when all else fails.")


@dataclass(frozen=True)
class RenewalSettings(Settings):
    """The carrying of the subsets to a newer keyframe, before the old one becomes useless."""

    after_frames: int = setting(
        20,
        unit="frames",
        low=0,
        high=100000,
        doc="Frames in a row that must ask for it, by one of the next two; 0: only `~/renew_keyframe` does.",
    )
    zncc_drop: float = setting(
        0.05, low=0.001, high=2.0, doc="A frame asks when its median ZNCC is so far below the keyframe's best."
    )
    max_stretch: float = setting(
        1.3,
        low=1.01,
        high=10.0,
        doc="A frame asks when it shows the panel stretched or shrunk by more, in any direction.",
    )
    min_found: float = setting(
        0.6,
        low=0.1,
        high=1.0,
        doc="Share of each region's subsets that must be found in a new keyframe; the others are lost from then on.",
    )


@dataclass(frozen=True)
class PairingSettings(Settings):
    """Which ToF frame belongs to an image (thesis 4.3.1)."""

    max_offset_s: float = setting(
        0.03, unit="s", low=0.0, high=1.0, doc="Largest time between an image and its ToF frame."
    )
    settle_s: float = setting(
        0.1,
        unit="s",
        low=0.0,
        high=2.0,
        doc="How much later an image must be before a missing ToF frame is given up.",
    )
    tof_delay_s: float = setting(
        0.0,
        unit="s",
        low=-1.0,
        high=1.0,
        doc="How much too late the stamps of the ToF frames are known to be; it is subtracted from them.",
    )
    max_attitude_offset_s: float = setting(
        0.1, unit="s", low=0.0, high=1.0, doc="Largest time between an image and the attitude that goes along with it."
    )

    @property
    def tof_delay_ns(self) -> int:
        """`tof_delay_s`, as it is subtracted from a stamp [ns]."""
        return round(self.tof_delay_s * 1e9)


@dataclass(frozen=True)
class PlaneSettings(Settings):
    """The plane through the ToF points of the panel."""

    min_points: int = setting(50, unit="points", low=3, high=100000, doc="Fewest ToF points on the panel.")
    min_inliers: float = setting(0.5, low=0.05, high=1.0, doc="Smallest share of them that must lie on the plane.")
    min_distance_m: float = setting(0.1, unit="m", low=0.0, high=100.0, doc="Nearer ToF points are dropped.")
    max_distance_m: float = setting(10.0, unit="m", low=0.0, high=1000.0, doc="Farther ToF points are dropped.")
    max_points: int = setting(
        1000000,
        unit="points",
        low=100,
        high=10000000,
        doc="Most ToF points on the panel that are used, evenly taken: fewer take less time and are noisier together.",
    )
    step: bool = setting(True, doc="Whether the step across the crack is measured; pc_3d alone needs it.")
    curvature: bool = setting(
        True, doc="Whether the bow of the panel is measured; compensation.bow_from: images_and_tof alone needs it."
    )
    max_residual_m: float = setting(
        0.03, unit="m", low=0.0005, high=1.0, doc="Largest residual RMS of a plane that is believed."
    )
    systematic_m: float = setting(
        0.004,
        unit="m",
        low=0.0,
        high=0.1,
        doc="Accuracy of the ToF sensor: standard uncertainty of its distances that frames share.",
    )
    systematic_length_m: float = setting(
        0.1,
        unit="m",
        low=0.001,
        high=100.0,
        doc="Difference in distance over which half of its variance changes.",
    )


@dataclass(frozen=True)
class CompensationSettings(Settings):
    """The removal of the camera's motion."""

    method: str = setting(
        "h_pose", choices=("h_pose", "h_joint", "h_3d", "h_2d", "pc_3d"), doc="How the motion is estimated and removed."
    )
    min_subsets: int = setting(12, unit="subsets", low=4, high=100000, doc="Fewest valid subsets in the fixed region.")
    inlier_px: float = setting(
        1.0,
        unit="px",
        low=0.01,
        high=50.0,
        doc="MSAC: largest residual of a subset that moves with the fixed region.",
    )
    max_trials: int = setting(500, unit="samples", low=10, high=100000, doc="MSAC: most samples drawn.")
    robust_sigmas: float = setting(
        3.0, low=1.0, high=10.0, doc="h_pose: residuals beyond this many standard deviations lose weight."
    )
    deformation_order: int = setting(
        4, low=1, high=5, doc="h_joint: order of the polynomials that each side of the crack deforms by."
    )
    parting: bool = setting(
        True,
        doc="h_2d: where the fixed region lies on both sides of the crack, how these part, slide and turn against each "
        "other is estimated along.",
    )
    bow_m: float = setting(
        0.001,
        unit="m",
        low=0.0,
        high=0.1,
        doc="h_pose, h_joint: how far the panel may stand out of its plane (standard deviation); 0: it is flat.",
    )
    bulge_m: float = setting(
        0.0005,
        unit="m",
        low=0.0,
        high=0.1,
        doc="h_joint: how far a loaded panel may bulge since the reference, at its edge against its middle (standard "
        "deviation); 0, or with bow_m: 0: it does not.",
    )
    bow_from: str = setting(
        "images",
        choices=("images", "images_and_tof"),
        doc="h_pose, h_joint: who tells how the panel is curved, the parallax in the images alone, or the averaged ToF "
        "frames as well.",
    )
    tof_slope: float = setting(
        0.03,
        low=0.0,
        high=1.0,
        doc="h_joint: part of a change of distance that the ToF sensor may get wrong (standard deviation); 1: it is "
        "not asked how the panel's plane moved.",
    )
    carry_offset_s: float = setting(
        0.01,
        unit="s",
        low=0.0,
        high=0.1,
        doc="A ToF plane enters the averaged reference plane through an image at most this far in time.",
    )
    plane_in_time: str = setting(
        "nearest",
        choices=("nearest", "carried"),
        doc="h_3d, pc_3d: the plane of the ToF frame nearest in time, as it is; or the mean of the latest ones, each "
        "carried to the image along the motion of the fixed region.",
    )
    plane_window_s: float = setting(
        1.0, unit="s", low=0.05, high=60.0, doc="carried: ToF frames up to this long before the image are averaged."
    )
    plane_lag_s: float = setting(
        0.0,
        unit="s",
        low=0.0,
        high=10.0,
        doc="h_pose, h_joint, h_2d: an image is measured with the ToF frames of images at least this much earlier, "
        "and waits for none; 0: it waits for its own.",
    )
    learn_every: int = setting(
        1,
        unit="images",
        low=1,
        high=100,
        doc="Every so-manieth image tells how the panel is curved, and how the camera moved, for the sensors' delay.",
    )
    max_waiting: int = setting(
        64,
        unit="frames",
        low=1,
        high=10000,
        doc="Frames that wait for their ToF plane before one is given up.",
    )


@dataclass(frozen=True)
class CrackSettings(Settings):
    """The opening between the zones on the two sides of the crack."""

    min_subsets: int = setting(3, unit="subsets", low=1, high=100000, doc="Fewest valid subsets on a side.")
    min_found: float = setting(
        0.5,
        low=0.0,
        high=1.0,
        doc="Smallest share of a zone's subsets that must be valid; with less it counts as hidden.",
    )


@dataclass(frozen=True)
class ProcessingSettings:
    """All stages together, as in the file that `--settings` names."""

    correlation: CorrelationSettings = field(default_factory=CorrelationSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    renewal: RenewalSettings = field(default_factory=RenewalSettings)
    pairing: PairingSettings = field(default_factory=PairingSettings)
    plane: PlaneSettings = field(default_factory=PlaneSettings)
    panel_finding: PanelFindingSettings = field(default_factory=PanelFindingSettings)
    compensation: CompensationSettings = field(default_factory=CompensationSettings)
    crack: CrackSettings = field(default_factory=CrackSettings)

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any], where: str = "settings") -> ProcessingSettings:
        stages = {stage.name: stage.default_factory for stage in fields(cls)}
        unknown = sorted(set(content) - set(stages))
        if unknown:
            raise SettingsError(f"{where}: unknown group {', '.join(unknown)}; known are {', '.join(stages)}")
        made = {name: stages[name].from_mapping(group or {}, f"{where}: {name}") for name, group in content.items()}
        return cls(**made)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Stage -> field -> value."""
        return {stage.name: getattr(self, stage.name).as_dict() for stage in fields(self)}


def load_settings(path: Path | str | None) -> ProcessingSettings:
    """Read a settings file, grouped by stage; None gives the defaults.

    Raises:
        SettingsError: naming the file, the group and the value.
    """
    if path is None:
        return ProcessingSettings()
    try:
        content = yaml.safe_load(Path(path).read_text()) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"cannot read settings {path}: {error}") from error
    if not isinstance(content, dict):
        raise SettingsError(f"{path}: expected groups of settings, got {content!r}")
    return ProcessingSettings.from_mapping(content, str(path))
