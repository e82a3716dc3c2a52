"""The report: its numbers against the files it was made from, its figures, and runs with little to tell."""

import base64
import csv
import math
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_processing.cli import main
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.displacement_field import DisplacementField
from rgbd_dic_processing.core.frame_quality import ImageQuality, PlaneQuality
from rgbd_dic_processing.core.opening_budget import OpeningBudget
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.search import SeedSource
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import Reference
from rgbd_dic_processing.frame_files import FrameRecords
from rgbd_dic_processing.report import write_report
from rgbd_dic_processing.report.drawing import STROKES, envelope, with_gaps
from rgbd_dic_processing.report.map_background import Background
from rgbd_dic_processing.report.map_sides import sides_of
from rgbd_dic_processing.runs import MapSelection, Run

START, PERIOD = 1_750_000_000_000_000_000, 50_000_000
CENTRES = np.stack(np.meshgrid(np.arange(20, 141, 10), np.arange(20, 101, 10)), axis=-1).reshape(-1, 2)
REGIONS = """
panel: [[5, 5], [155, 5], [155, 115], [5, 115]]
fixed: [[[5, 5], [65, 5], [65, 115], [5, 115]]]
crack: {point: [80, 60], direction: [0, 1], size: [30, 60], gap: 12}
"""
NAN = math.nan


def stamp(k):
    return START + k * PERIOD


def truth_mm(k):
    return 0.7 + 0.02 * k  # an opening of 0.7 mm before the reference, which must not count


def opening(k, method="h_pose", error_mm=0.0, **changes):
    value = (truth_mm(k) - truth_mm(0) + error_mm) * 1e-3
    made = CrackOpening(
        stamp(k), START, method, FrameStatus.OK, "", value, 0.0, NAN, abs(value),
        2e-6 * (1 + k / 30), NAN, NAN, NAN, 40, 41, 0.004, NAN,
    )  # fmt: skip
    return replace(made, **changes)


def failed(k, method, status, reason):
    lengths = dict.fromkeys(("opening_m", "sliding_m", "magnitude_m", "u_opening_m"), NAN)
    return opening(k, method, status=status, reason=reason, n_left=0, n_right=0, **lengths)


def field(k, method="h_pose"):
    moved = np.where(CENTRES[:, :1] > 80, [truth_mm(k) * 1e-3, 1e-4, NAN], [0.0, 0.0, NAN])
    moved = moved + np.random.default_rng(k).normal(0, 1e-6, moved.shape)
    moved[7] = NAN
    return DisplacementField(
        stamp(k), START, START, method, FrameStatus.OK, "", 0.004, 9, CENTRES.astype(np.float32),
        CENTRES * 1e-3, moved, np.full(moved.shape, 1e-6, np.float32), np.zeros((0, 3, 6)), np.zeros(0, np.uint8),
        np.zeros((0, 2, 3)),
        1e-3, np.nan, 0.01,
    )  # fmt: skip


def usual_run():
    """Two methods over 30 frames; h_3d loses two frames and has no ToF frame in another."""
    noise = np.random.default_rng(1).normal(0, 1, (2, 30))
    openings = [opening(k, "h_pose", 0.002 * noise[0, k]) for k in range(30)]
    openings += [opening(k, "h_3d", 0.08 * noise[1, k]) for k in range(30)]
    for k in (34, 35):
        openings[k] = failed(k - 30, "h_3d", FrameStatus.LOST, "the pattern <i>was</i> not found")
    openings[50] = failed(20, "h_3d", FrameStatus.NO_DEPTH_FRAME, "no ToF frame near enough in time")
    image = np.random.default_rng(2).integers(0, 256, (120, 160), np.uint8)
    return Run(
        openings,
        {
            "h_pose": {"widest": field(29), "last": field(29)},
            "h_3d": {"widest": field(28), "last": field(29)},
        },
        Reference.first(START, image, CENTRES, 9, 10),
        {"bag": "/home/somebody/flights/bridge_4", "regions": "regions.yaml"},
        ProcessingSettings().as_dict(),
        {"frames lost": 0},
        frames=frame_records(openings),
    )


PARTS_MM = {"h_pose": (3e-3, 4e-3, -1e-3, 2e-3, 0, 0, 0, 1e-3), "h_3d": (3e-3, 4e-3, 0, 1e-3, 60e-3, 0, 0, 1e-3)}


def frame_records(openings):
    """30 images, 10 ToF frames of which two have no plane, and the same budget for all openings of a method."""
    images = [
        ImageQuality(stamp(k), FrameStatus.OK, SeedSource.PREDICTION, 117, 116, 0.99 - 1e-3 * k, 0.95, 0.003, 0.004)
        for k in range(30)
    ]
    planes = [PlaneQuality(stamp(3 * k), FrameStatus.OK, "", 900, 880, 0.005, 1.2, 0.1) for k in range(8)]
    reason = "12 ToF points on the panel, at least 50 needed"
    planes += [PlaneQuality(stamp(3 * k), FrameStatus.NO_PLANE, reason, 12, 0, NAN, NAN, NAN) for k in (8, 9)]
    roots = {method: np.array(values) * 1e-3 for method, values in PARTS_MM.items()}
    budgets = [
        OpeningBudget(o.stamp_ns, o.method, math.sqrt(sum(root * abs(root))), root * abs(root), 0.01)
        for o in openings
        if o.valid
        for root in (roots[o.method],)
    ]
    return FrameRecords(images, planes, budgets)


def saved(run, folder, truth=True, regions=True):
    folder.mkdir()
    if truth:
        lines = [f"{stamp(k)},{truth_mm(k):.9f}\n" for k in range(30)]
        (folder / "truth.csv").write_text("stamp_ns,opening_mm\n" + "".join(lines))
    if regions:
        (folder / "regions.yaml").write_text(REGIONS)
    run.save(folder)
    return folder


class Tables(HTMLParser):
    """The cells of every table with an id: id -> rows of texts."""

    def __init__(self, text):
        super().__init__()
        self.tables, self._rows, self._cell = {}, None, None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag == "table":
            self._rows = self.tables.setdefault(dict(attributes).get("id"), [])
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._cell = ""

    def handle_data(self, data):
        if self._cell is not None:
            self._cell += data

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._rows[-1].append(self._cell.strip())
            self._cell = None


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    folder = saved(usual_run(), tmp_path_factory.mktemp("runs") / "usual")
    page = write_report(folder)
    assert page == folder / "report.html"
    return folder, page.read_text(encoding="utf-8")


def test_numbers_of_the_page_are_those_of_the_files(usual):
    folder, text = usual
    with (folder / "crack_opening.csv").open() as file:
        rows = list(csv.DictReader(file))
    header, *lines = Tables(text).tables["methods"]
    assert [line[0] for line in lines] == ["h_pose", "h_3d"]
    for line in lines:
        mine = [row for row in rows if row["method"] == line[0] and row["valid"] == "1"]
        value = np.array([float(row["opening_mm"]) for row in mine])
        u = np.array([float(row["u_opening_mm"]) for row in mine])
        error = value - np.array([0.02 * (int(row["stamp_ns"]) - START) / PERIOD for row in mine])
        shown = dict(zip(header, line, strict=True))
        assert (shown["frames"], shown["valid"]) == ("30", "30" if line[0] == "h_pose" else "27")
        expected = {
            "RMS error [mm]": math.sqrt(sum(error**2) / (len(error) - 1)),
            "mean error [mm]": error.mean(),
            "largest |error| [mm]": max(abs(error)),
            "mean stated u [mm]": u.mean(),
            "last opening [mm]": value[-1],
            "widest opening [mm]": max(value, key=abs),
        }
        for name, number in expected.items():
            decimals = len(shown[name].partition(".")[2])
            assert decimals >= 4
            # half of the last digit shown, and what the CSV rounds away
            assert float(shown[name]) == pytest.approx(number, abs=0.51 * 10**-decimals + 1e-9), name
        within = 100 * np.mean(abs(error) <= 2 * u)
        assert float(shown["error within 2 u"].removesuffix("%")) == pytest.approx(within, abs=0.51)


def test_budget_adds_up(usual):
    """The rows are those of `PARTS_MM` that occur, with their signs, and the last is the root of their squares' sum."""
    _, text = usual
    header, *rows = Tables(text).tables["budget"]
    assert header[1:] == ["h_pose", "h_3d"]
    shown = {row[0]: [float(value) for value in row[1:]] for row in rows}
    assert len(shown) == 7  # without deformation and curvature; the last is the sum
    for place, parts in enumerate(PARTS_MM.values()):
        values = [column[place] for column in shown.values()]
        occurring = [parts[i] for i in (0, 1, 2, 3, 4, 7)]
        assert values[:-1] == pytest.approx(occurring, abs=0.51e-5)
        assert values[-1] == pytest.approx(math.sqrt(sum(v * abs(v) for v in occurring)), abs=0.51e-5)


def test_tof_frames_without_a_plane_are_told(usual):
    _, text = usual
    assert "10 ToF frames, 8 with a plane" in text
    rows = Tables(text).tables["planes"][1:]
    assert rows == [["no plane found", "2", "12 ToF points on the panel, at least 50 needed"]]


CALIBRATED = """
camera:
  image_size_px: [160, 120]
  focal_length_px: [819.5, 821.97]
  principal_point_px: [79.5, 59.5]
  radial_distortion: [0.0084, 0.0843]
"""
ESTIMATED = """
estimates:
  camera.fx: {value: 819.5, u: 0.12}
  camera.fy: {value: 822.5, u: 0.12}
"""


def test_uncertainties_of_the_calibration_belong_to_its_numbers(tmp_path):
    """fy is not the one that was estimated; k1 was not estimated at all."""
    folder = saved(replace(usual_run(), maps={}), tmp_path / "run")
    (folder / "calibration.yaml").write_text(CALIBRATED)
    (folder / "estimates.yaml").write_text(ESTIMATED)
    rows = Tables(write_report(folder).read_text(encoding="utf-8")).tables["calibrated"][1:]
    shown = {row[0]: row[1:4] for row in rows}
    assert shown["camera.fx"] == ["819.50", "0.12", "px"]
    assert shown["camera.fy"] == ["821.97", "–", "px"]
    assert shown["camera.k1"] == ["0.0084", "–", ""]
    assert len(shown) == 6


def test_a_line_breaks_where_frames_are_missing():
    """Of frames every 0.1 s, 9 are missing after the fifth, and one after the tenth, which is bridged."""
    time = np.delete(np.arange(25) * 0.1, [*range(5, 14), 19])
    drawn, values = with_gaps(time, np.ones(len(time)))
    assert len(drawn) == 24 and np.isnan(values).sum() == 9
    assert np.isnan(values[5:14]).all() and (np.diff(drawn) > 0).all()


def test_maps_of_chosen_moments_are_the_nearest_valid_ones():
    selection = MapSelection([0.26, 5.0])
    for k in range(30):
        valid = k != 5
        selection.add(field(k) if valid else replace(field(k), status=FrameStatus.LOST), opening(k))
    kept = selection.maps()["h_pose"]
    assert {label: one.stamp_ns for label, one in kept.items()} == {
        "widest": stamp(29), "last": stamp(29), "at_0.26_s": stamp(6), "at_5_s": stamp(29)
    }  # fmt: skip


def test_invalid_frames_are_counted_by_reason(usual):
    _, text = usual
    _, *lines = Tables(text).tables["failures"]
    assert lines == [
        ["h_3d", "pattern not found", "2", "0.20", "0.25", "0.10", "the pattern <i>was</i> not found"],
        ["h_3d", "no ToF frame in time", "1", "1.00", "1.00", "0.05", "no ToF frame near enough in time"],
    ]
    assert "<i>" not in text


def test_page_needs_and_tells_nothing_from_outside(usual):
    folder, text = usual
    assert not re.search(r"https?:|<script|<link|href=.(?!#)|@import|url\(", text)
    assert all(source.startswith("data:image/png;base64,") for source in re.findall(r'src="([^"]*)"', text))
    assert "bridge_4" in text
    assert "/home/" not in text and str(folder.parent) not in text
    assert len(re.findall(r"<img alt=\"[^\"]{20,}\"", text)) == text.count("<img")


def test_figures_are_drawn_and_embedded(usual):
    folder, text = usual
    embedded = [base64.b64decode(data) for data in re.findall(r"base64,([^\"]*)", text)]
    names = ["overview", "history", "validity", "maps_h_pose_widest", "maps_h_3d_widest", "maps_h_3d_last", "budget"]
    names += ["quality", "tof", "zone_sensitivity"]
    assert embedded == [(folder / f"{name}.png").read_bytes() for name in names]
    assert not (folder / "maps_h_pose_last.png").exists()  # the widest frame of h_pose is its last
    for name in names:
        pixels = cv2.imread(str(folder / f"{name}.png"))
        coloured = np.ptp(pixels.astype(int), axis=2) > 60
        assert coloured.mean() > 0.002, name


def test_reference_of_another_clock_is_shown_beside_the_run(tmp_path):
    """Of three methods one has too few frames; numbers of the page are those of history_comparison.csv."""
    cycle = [0.3e-3 * math.sin(2 * math.pi * 0.5 * k / 20) for k in range(120)]
    run = usual_run()
    openings = [opening(k, method, opening_m=cycle[k]) for method in ("h_pose", "h_2d") for k in range(120)]
    openings += [failed(k, "h_3d", FrameStatus.LOST, "lost") for k in range(120)]
    folder = saved(replace(run, openings=openings), tmp_path / "run", truth=False)
    rows = [f"{k / 5 + 0.31:.3f},{0.3 * math.sin(2 * math.pi * 0.5 * k / 5) + 0.1:.6f},0.1\n" for k in range(28)]
    (tmp_path / "dic.csv").write_text("time_s,opening_mm,sliding_mm\n" + "".join(rows))
    assert main(["report", str(folder), "--reference", str(tmp_path / "dic.csv"), "--shifts", "-0.5", "0.8"]) == 0
    text = (folder / "report.html").read_text(encoding="utf-8")
    with (folder / "history_comparison.csv").open() as file:
        written = list(csv.DictReader(file))
    header, *lines = Tables(text).tables["reference"]
    assert [line[0] for line in lines] == ["h_pose", "h_pose", "h_2d", "h_2d"]
    for line, row in zip(lines, [row for row in written if not row["reason"]], strict=True):
        shown = dict(zip(header, line, strict=True))
        assert float(shown["delay [s]"]) == pytest.approx(float(row["delay_s"]), abs=5.1e-5)
        assert float(shown["RMS [mm]"]) == pytest.approx(float(row["rms_mm"]), abs=5.1e-5)
        assert float(row["delay_s"]) == pytest.approx(0.31, abs=2e-3)
        assert float(row["offset_mm"]) == pytest.approx(-0.1, abs=2e-3)
        assert float(row["sliding_rms_mm"]) == pytest.approx(0.0, abs=1e-6)
    frequencies = [float(cell) for cell in Tables(text).tables["spectra"][1][1:4:2]]
    assert frequencies == pytest.approx([0.5, 0.5], abs=1e-3)
    assert "h_3d could not be compared: 0 valid values" in text
    for name in ("alignment", "correlation", "spectra", "zone_sensitivity"):
        assert base64.b64encode((folder / f"{name}.png").read_bytes()).decode() in text
    zones = Tables(text).tables["zones"]
    assert [row[:2] for row in zones[1:4]] == [
        ["h_pose", "left rectangle"], ["h_pose", "right rectangle"], ["h_pose", "both, by the point"]
    ]  # fmt: skip
    # both halves are shifted as a whole: only noise of 0.001 mm a subset is left
    assert all(abs(float(value)) < 1e-3 for row in zones[1:] for value in row[2:])


def test_reference_that_fits_no_method_is_refused(tmp_path, capsys):
    folder = saved(usual_run(), tmp_path / "run")
    (tmp_path / "late.csv").write_text("time_s,opening_mm\n" + "".join(f"{900 + k},{k % 3}\n" for k in range(12)))
    assert main(["report", str(folder), "--reference", str(tmp_path / "late.csv")]) == 1
    assert "h_pose: the reference, 900.00 to 911.00 s" in capsys.readouterr().err
    assert not (folder / "history_comparison.csv").exists()


def only_failures(run):
    openings = [failed(k, "h_pose", FrameStatus.BAD_DEPTH, "empty depth frame") for k in range(5)]
    return replace(run, openings=openings, maps={}, frames=FrameRecords())


@pytest.mark.parametrize(
    ("change", "says", "pictures"),
    [
        (only_failures, "No frame of this run is valid", 2),
        (lambda run: replace(run, openings=[], frames=FrameRecords()), "displacement maps only", 2),
        (lambda run: replace(run, openings=[], frames=replace(run.frames, budgets=[])), "displacement maps only", 4),
        (
            lambda run: replace(run, openings=[], maps={}, reference=None, frames=FrameRecords()),
            "no frame was measured",
            0,
        ),
        (lambda run: replace(run, openings=run.openings[:30], maps={}, frames=FrameRecords()), "no valid field was", 3),
        (lambda run: replace(run, openings=run.openings[:1], frames=FrameRecords()), "1 image over 0.00 s", 6),
        (lambda run: replace(run, reference=None, settings={}), "None were saved", 9),
    ],
    ids=["no valid frame", "no crack", "no crack but frames", "nothing", "one method", "one row", "no reference"],
)
@pytest.mark.filterwarnings("error")
def test_little_to_tell_is_told(change, says, pictures, tmp_path):
    folder = saved(change(usual_run()), tmp_path / "run", truth=False, regions=pictures < 3)
    text = write_report(folder).read_text(encoding="utf-8")
    assert says in text
    assert text.count("<img") == pictures
    assert "RMS error" not in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text)


def test_truth_of_other_frames_compares_nothing(tmp_path):
    other = tmp_path / "other.csv"
    other.write_text("stamp_ns,opening_mm\n12,0.5\n")
    text = write_report(saved(replace(usual_run(), maps={}), tmp_path / "run"), other).read_text(encoding="utf-8")
    assert "no valid frame has a truth to compare with" in text
    assert "RMS error" not in text


def test_truth_counts_from_the_reference_even_if_its_row_is_missing(tmp_path):
    run = replace(usual_run(), openings=usual_run().openings[10:30], maps={})
    text = write_report(saved(run, tmp_path / "run")).read_text(encoding="utf-8")
    header, line = Tables(text).tables["methods"]
    assert float(line[header.index("largest |error| [mm]")]) < 0.01


def test_what_is_not_a_run_is_refused(tmp_path):
    with pytest.raises(RgbdDicError, match="not the folder of a run"):
        write_report(tmp_path)


def test_long_history_keeps_its_extremes_and_gaps():
    time = np.arange(36_001.0)
    values = np.random.default_rng(3).normal(0, 1, len(time))
    values[12_345], values[20_000] = 50.0, -40.0
    values[30_000:31_000] = np.nan
    drawn, low, high = envelope(time, values, values)
    assert len(drawn) == len(low) == len(high) <= STROKES
    assert high.max(initial=0, where=np.isfinite(high)) == 50.0
    assert low.min(initial=0, where=np.isfinite(low)) == -40.0
    assert abs(drawn[np.nanargmax(high)] - 12_345) < 36_001 / STROKES
    inside = (drawn > 30_040) & (drawn < 30_960)
    assert np.isnan(low[inside]).all() and np.isfinite(low[~inside]).mean() > 0.99


def test_subsets_lie_on_the_side_and_the_cell_they_belong_to(tmp_path):
    (tmp_path / "regions.yaml").write_text(REGIONS)
    regions, moved = load_regions(tmp_path / "regions.yaml"), field(29)
    fixed, moving = sides_of(regions, moved)
    assert (fixed.name, moving.name) == ("fixed region", "moving part")
    np.testing.assert_array_equal(fixed.members, CENTRES[:, 0] <= 65)
    # a subset of 9 px touches the crack at x = 80 px if its centre is within 4.5 px
    np.testing.assert_array_equal(moving.members, CENTRES[:, 0] > 84.5)
    assert [side.name for side in sides_of(None, moved)] == ["panel"]
    grid = Background.of(usual_run().reference, regions, moved).on_grid(moved.displacement_m[:, 0])
    assert grid.shape == (9, 13)
    assert grid[2, 9] == moved.displacement_m[np.all(CENTRES == (110, 40), axis=1), 0]
    assert np.isnan(grid[0, 7]) and np.isnan(grid).sum() == 1


def test_matplotlib_is_loaded_late_and_pyplot_never(tmp_path):
    folder = saved(replace(usual_run(), maps={"h_pose": {"last": field(9)}}), tmp_path / "run")
    code = (
        "import sys; from pathlib import Path; from rgbd_dic_processing.report import write_report\n"
        "assert 'matplotlib' not in sys.modules and 'jinja2' not in sys.modules\n"
        f"write_report(Path({str(folder)!r}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
