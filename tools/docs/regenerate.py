"""Writes what docs can take from the code and from the last `make demo` and `make validate`, so that it does not drift.

`make docs` runs it; with --check nothing is written, and the exit code is 1 if something that depends on the code alone
is out of date.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import node_tables
import settings_tables
from blocks import replace_block, table
from pictures import small_copy
from rgbd_dic_processing.calibrating.settings import CalibratingSettings
from rgbd_dic_processing.frame_files import BUDGETS_HEADER, IMAGES_HEADER, PLANES_HEADER
from rgbd_dic_processing.history.settings import AlignmentSettings
from rgbd_dic_processing.results import HEADER

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "results" / "demo"
CHAPTERS = {chapter: ROOT / "results" / chapter for chapter in ("chapter3", "chapter4")}
PICTURES = {  # docs/images <- what made it, and the file there
    "demo_overview.png": (DEMO, "overview.png"),
    "demo_history.png": (DEMO, "history.png"),
    "demo_budget.png": (DEMO, "budget.png"),
    "demo_maps.png": (DEMO, "maps_h_pose_widest.png"),
    **{
        f"{chapter}_{name}.png": (CHAPTERS[chapter], f"{chapter}_{name}.png")
        for chapter, names in (
            ("chapter3", ("images", "averages", "rms", "trends", "cracks", "maps_2_5", "maps_2_6", "oblique")),
            ("chapter4", ("image", "cloud", "shape", "maps", "map_errors", "history", "budget")),
            ("chapter4", ("alignment", "correlation", "spectra", "zone_sensitivity")),
        )
        for name in names
    },
}
FIRST_PICTURE = "demo_overview.png"  # of the README, in full colour

# Columns of crack_opening.csv: unit, meaning, when it is nan or empty.
COLUMNS = {
    "stamp_ns": ("ns", "stamp of the image, its moment of exposure, since the epoch", "never"),
    "method": ("", "compensation method: `h_pose`, `h_joint`, `h_3d`, `h_2d` or `pc_3d`", "never"),
    "opening_mm": ("mm", "change since the reference normal to the crack, positive when its sides part", "not valid"),
    "sliding_mm": (
        "mm",
        "along the crack, right zone minus left; positive is 90 degrees from the normal, from x towards y",
        "not valid",
    ),
    "out_of_plane_mm": ("mm", "into the wall, right zone minus left", "not valid, or not `pc_3d`"),
    "magnitude_mm": ("mm", "length of all components that are known", "not valid"),
    "u_opening_mm": ("mm", "standard uncertainty of `opening_mm`", "not valid"),
    "n_left": ("subsets", "used in the left zone", "never"),
    "n_right": ("subsets", "used in the right zone", "never"),
    "depth_offset_s": (
        "s",
        "stamp of the image minus that of its ToF frame less `pairing.tof_delay_s`",
        "no ToF frame is near enough, or the image cannot be measured",
    ),
    "latency_s": ("s", "from the arrival of the image at `dic_node` to the publishing of its opening", "offline"),
    "valid": ("", "1 or 0", "never"),
    "reason": ("", "why it is not valid: a status of `FrameStatus.msg`, a colon, and words", "valid (empty)"),
    "reference_stamp_ns": ("ns", "stamp of the reference that the row counts from; 0 if there was none yet", "never"),
}


IMAGES_COLUMNS = {
    "stamp_ns": ("ns", "stamp of the image", "never"),
    "status": ("", "of the DIC: `OK`, `BAD_IMAGE` or `LOST`", "never"),
    "seed": ("", "where the first guess came from: `SEED_...` of `SubsetField.msg`", "never"),
    "subsets": ("", "of the reference", "never"),
    "found": ("", "of these, those that were found", "never"),
    "zncc_median": ("", "median of the correlation of the found ones", "none was found"),
    "zncc_5th_percentile": ("", "its 5th percentile", "none was found"),
    "sigma_px": ("px", "median of the standard uncertainty of a coordinate of the found ones", "none was found"),
    "depth_offset_s": (
        "s",
        "as in `crack_opening.csv`, whether the image could be measured or not",
        "no ToF frame is near",
    ),
}
PLANES_COLUMNS = {
    "stamp_ns": ("ns", "stamp of the ToF frame, less `pairing.tof_delay_s`", "never"),
    "status": ("", "`OK`, `BAD_DEPTH` or `NO_PLANE`", "never"),
    "points": ("", "ToF points in the panel region", "never"),
    "inliers": ("", "of these, those on the plane", "never"),
    "residual_rms_mm": ("mm", "RMS of the inliers' distance from the plane, along z", "no plane"),
    "distance_mm": ("mm", "of the plane from the camera", "no plane"),
    "tilt_deg": ("degrees", "between the plane's normal and the camera's axis", "no plane"),
    "reason": ("", "why there is no plane, in words", "there is one (empty)"),
}
BUDGETS_COLUMNS = {
    "stamp_ns": ("ns", "stamp of the image", "never"),
    "method": ("", "compensation method", "never"),
    "u_opening_mm": ("mm", "standard uncertainty of the opening", "never"),
    "u_subsets_mm": ("mm", "noise of the subsets in the zones, with way to the keyframe and misfit", "never"),
    "u_motion_mm": ("mm", "the same in the fixed region, by way of the motion", "never"),
    "u_overlap_mm": ("mm", "twice the covariance of these two", "never"),
    "u_reference_plane_mm": ("mm", "plane of the panel in the reference", "never"),
    "u_frame_plane_mm": ("mm", "plane of the panel in the image", "never"),
    "u_deformation_mm": (
        "mm",
        "deformation of the fixed region that may be taken for motion; `h_joint`: with the panel's plane",
        "never",
    ),
    "u_shape_mm": ("mm", "curvature of the panel", "never"),
    "u_scale_mm": ("mm", "scale of all lengths: distance of the reference plane", "never"),
    "residual_px": ("px", "RMS reprojection error of the fixed region's subsets that agree with the motion", "never"),
}


def csv_table(name: str, columns: dict[str, tuple[str, str, str]], header: Sequence[str]) -> Callable[[], str]:
    """The columns of a CSV file."""

    def made() -> str:
        if tuple(columns) != tuple(header):
            raise SystemExit(f"the columns of {name} are {', '.join(header)}: describe them in {__file__}")
        rows = [(f"`{column}`", unit, meaning, missing) for column, (unit, meaning, missing) in columns.items()]
        return table(("Column", "Unit", "Meaning", "nan when"), rows)

    return made


def demo_table() -> str | None:
    """What `make demo` printed last."""
    path = DEMO / "summary.md"
    return path.read_text() if path.exists() else None


def chapter_table(chapter: str, name: str) -> Callable[[], str | None]:
    """A table of the last `make validate`."""
    path = CHAPTERS[chapter] / "tables" / f"{name}.md"
    return lambda: path.read_text() if path.exists() else None


# File -> its blocks -> what belongs in them; None if that is not there.
FROM_CODE: dict[str, dict[str, Callable[[], str | None]]] = {
    "docs/parameters.md": {
        "stages": lambda: settings_tables.sections(settings_tables.STAGES),
        "nodes": lambda: settings_tables.sections(settings_tables.NODES),
        "flight": lambda: settings_tables.sections(settings_tables.FLIGHT),
    },
    "docs/nodes.md": {
        "processing": lambda: node_tables.section("rgbd_dic_processing", node_tables.PROCESSING),
        "acquisition": lambda: node_tables.section("rgbd_dic_acquisition", node_tables.ACQUISITION),
    },
    "docs/files.md": {
        "csv": csv_table("crack_opening.csv", COLUMNS, HEADER),
        "images": csv_table("images.csv", IMAGES_COLUMNS, IMAGES_HEADER),
        "planes": csv_table("planes.csv", PLANES_COLUMNS, PLANES_HEADER),
        "budgets": csv_table("uncertainty.csv", BUDGETS_COLUMNS, BUDGETS_HEADER),
    },
    "docs/calibration.md": {"calibrating": lambda: settings_tables.sections({"calibrating": CalibratingSettings})},
    "docs/history.md": {"alignment": lambda: settings_tables.sections({"alignment": AlignmentSettings})},
    "docs/laboratory.md": {"laboratory": lambda: settings_tables.sections(settings_tables.LABORATORY)},
}
FROM_RUN: dict[str, dict[str, Callable[[], str | None]]] = {
    "README.md": {"demo": demo_table},
    "docs/validation_chapter3.md": {
        name: chapter_table("chapter3", name)
        for name in (
            *("criteria", "calibration", "patterns", "poses", "thesis", "maps", "trends", "minimal", "calibrations"),
            *("cracks", "budget", "coverage", "oblique"),
        )
    },
    "docs/validation_chapter4.md": {
        name: chapter_table("chapter4", name)
        for name in ("facts", "criteria", "thesis", "openings", "aligned", "regions", "maps", "budget", "hard", "axes")
    },
}
PROCESSING_YAML = ROOT / "src/rgbd_dic_processing/config/processing.yaml"


def new_texts(blocks: dict[str, dict[str, Callable[[], str | None]]]) -> dict[Path, str]:
    """Each file with its blocks filled anew; says what is skipped."""
    texts = {}
    for name, contents in blocks.items():
        path = ROOT / name
        if not path.exists():
            print(f"{name} is missing: its blocks {', '.join(contents)} are skipped")
            continue
        text = path.read_text()
        for block, make in contents.items():
            content = make()
            filled = None if content is None else replace_block(text, block, content)
            if content is None:
                print(f"{name}: block {block} is left as it is: run make demo or make validate first")
            elif filled is None:
                print(
                    f"{name}: block {block} is skipped: there is no <!-- begin: {block} --> ... <!-- end: {block} -->"
                )
            text = filled or text
        texts[path] = text
    return texts


def copy_pictures() -> None:
    """Pictures of the demonstration and of the validations that a page shows, made small."""
    pages = "".join(path.read_text() for path in (ROOT / "README.md", *ROOT.glob("docs/**/*.md")) if path.exists())
    for name, (folder, source) in PICTURES.items():
        if f"images/{name}" not in pages:
            print(f"docs/images/{name} is skipped: no page shows it")
        elif not (folder / source).exists():
            print(f"docs/images/{name} is left as it is: run make demo or make validate first")
        else:
            small_copy(folder / source, ROOT / "docs" / "images" / name, full_colour=name == FIRST_PICTURE)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if something is out of date")
    check = parser.parse_args().check
    missing = node_tables.undocumented_parameters()
    if missing:
        raise SystemExit(f"parameters of the processing nodes that settings_tables.py lacks: {', '.join(missing)}")
    texts = {**new_texts(FROM_CODE), PROCESSING_YAML: settings_tables.processing_yaml()}
    if not check:
        texts |= new_texts(FROM_RUN)
    changed = [path for path, text in texts.items() if not path.exists() or path.read_text() != text]
    for path in changed:
        print(f"{path.relative_to(ROOT)}: {'out of date, run make docs' if check else 'written'}")
        if not check:
            path.write_text(texts[path])
    if not check:
        copy_pictures()
    return 1 if check and changed else 0


if __name__ == "__main__":
    raise SystemExit(main())
