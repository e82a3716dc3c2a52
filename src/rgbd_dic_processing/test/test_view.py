"""What viewers are shown of an image, against a known scene: a plane, a camera that moves, a lens that bends."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Calibration, Camera
from rgbd_dic_acquisition.errors import CalibrationError, ImageError
from rgbd_dic_acquisition.message_types import make_message, serialise, typestore
from rgbd_dic_acquisition.messages import points_from_message
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.displacement_field import DisplacementField
from rgbd_dic_processing.core.geometry import Plane, plane_homography
from rgbd_dic_processing.core.plane import PlaneEstimate
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.regions_file import regions_of
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.view import BLUE, RED, WHITE, ColourScale, View, Viewing, nearest_plane
from rgbd_dic_processing.nodes.attended import GONE_S, Attended
from rgbd_dic_processing.nodes.same_stamp import SameStamp
from rgbd_dic_processing.nodes.view_messages import ViewerSettings, band_message, cloud_message, view_messages
from rgbd_dic_processing.nodes.viewer import Viewer
from scipy.spatial.transform import Rotation

CAMERA = Camera(480, 360, 820.0, 822.0, 239.5, 179.5, -0.25, 0.08)
NORMAL = Rotation.from_euler("xy", (0.05, -0.1)).apply([0.0, 0.0, 1.0])
PLANE = Plane(NORMAL, -1.2, np.zeros((4, 4)))
R, T = Rotation.from_euler("xyz", (0.02, -0.03, 0.04)).as_matrix(), np.array([0.03, -0.02, 0.05])
REGIONS = regions_of(
    {
        "panel": [[60, 50], [420, 55], [415, 310], [65, 300]],
        "fixed": [[[60, 50], [220, 52], [220, 305], [65, 300]]],
        "fixed_holes": [[[100, 100], [130, 100], [115, 140]]],
        "crack": {"point": [240, 180], "direction": [0, 1], "size": [60, 120], "gap": 20},
    }
)
APART_M = 4e-4


def field_of(regions: Regions | None = REGIONS) -> DisplacementField:
    """A grid of subsets whose right half has moved by APART_M along x; the panel frame is that of the camera."""
    centres = np.stack(np.meshgrid(np.arange(80, 400, 20.0), np.arange(80, 280, 20.0)), axis=-1).reshape(-1, 2)
    points = PLANE.points(CAMERA.rays(CAMERA.undistort(centres)))
    moved = np.where(centres[:, 0] > 240, APART_M, 0.0)
    displacement = np.column_stack([moved, 0 * moved, np.full(len(moved), np.nan)])
    displacement[3] = np.nan
    return DisplacementField(
        *(100, 1, 1, "h_pose", FrameStatus.OK, "", 0.0, 31.0),
        centres.astype(np.float32),
        points[:, :2],
        displacement,
        np.full((len(centres), 3), 2e-6, np.float32),
        *(np.zeros((0, 3, 6)), np.zeros(0, np.uint8), np.zeros((0, 2, 3)), 0.0, np.nan, 0.01),
    )


def view_of(plane: Plane | None = None, regions: Regions | None = REGIONS, homography=None, small=None) -> View:
    homography = plane_homography(CAMERA, R, T, PLANE) if homography is None else homography
    small = np.zeros((180, 240), np.uint8) if small is None else small
    return Viewing(CAMERA).view(small, homography, regions, field_of(regions), plane)


def opening(status: FrameStatus = FrameStatus.OK) -> CrackOpening:
    value, u, reason = (5e-4, 4e-6, "") if status == FrameStatus.OK else (np.nan, np.nan, "too dark")
    return CrackOpening(*(100, 1, "h_pose", status, reason, value, 1e-4, np.nan, value, u, u, np.nan, u, 9, 9, 0.0))


def test_outlines_lie_on_the_panel_in_the_picture_and_in_space() -> None:
    """Exact but for rounding: the drawn corners, cut with the plane, moved with the camera and projected.

    The picture has half of the pixels; the centre of its first pixel is the corner between the first four.
    """
    moved = PLANE.moved(R, T)
    view = view_of(moved)
    drawn = {
        "panel": REGIONS.panel,
        "fixed": REGIONS.fixed[0],
        "left": REGIONS.crack.left,
        "right": REGIONS.crack.right,
    }
    for name, corners in drawn.items():
        points = PLANE.points(CAMERA.rays(CAMERA.undistort(corners))) @ R.T + T
        np.testing.assert_allclose(view.outlines_m[name][0], points, atol=1e-9)
        expected = (CAMERA.project(points) + 0.5) / 2 - 0.5
        np.testing.assert_allclose(view.outlines_px[name][0], expected, atol=1e-9)
    np.testing.assert_allclose(view.camera.project(view.subsets_m), view.subsets_px, atol=1e-9)
    np.testing.assert_allclose(view.subsets_m @ moved.normal + moved.d, 0, atol=1e-12)


def test_subsets_carry_their_displacement_across_the_crack() -> None:
    """The crack stands upright in the image of a tilted plane: its normal is within 0.05 rad of the panel's x."""
    view = view_of(PLANE)
    assert len(view.subsets_px) == len(field_of().centres_px) - 1  # the one that was lost is not shown
    right = view.displacement_m[:, 0] > APART_M / 2
    assert 0.4 < right.mean() < 0.6
    np.testing.assert_allclose(view.displacement_m[right, 0], APART_M, rtol=0.00125)
    np.testing.assert_allclose(view.displacement_m[~right, :2], 0, atol=1e-15)
    np.testing.assert_allclose(view.sigma_m, 2e-6, rtol=1e-6)


def test_the_picture_has_no_distortion() -> None:
    """A spot drawn where the lens puts a known point is found where a lens without distortion would put it.

    Off by up to 6 pixels before; bilinear interpolation moves the spot's centroid by less than 0.05.
    """
    ideal = np.array([[60.0, 60.0], [240.0, 180.0], [420.0, 300.0], [400.0, 70.0]])
    raw = CAMERA.distort(ideal)
    assert np.abs(raw - ideal).max() > 2
    x, y = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    spots = sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 3.0**2)) for u, v in raw)
    view = view_of(small=np.round(250 * spots).astype(np.uint8))
    for u, v in ideal:
        near = np.where((np.abs(x - u) < 15) & (np.abs(y - v) < 15), view.picture.astype(float), 0)
        found = np.array([np.sum(x * near), np.sum(y * near)]) / near.sum()
        np.testing.assert_allclose(found, (u, v), atol=0.05)


def test_without_a_plane_nothing_is_placed_in_space() -> None:
    view = view_of(None)
    assert view.outlines_m == {} and len(view.outlines_px["left"]) == 1
    assert len(view.subsets_m) == len(view.subsets_px) > 0 and np.isnan(view.subsets_m).all()


def test_an_image_without_the_panel_has_its_picture_alone() -> None:
    view = view_of(PLANE, homography=np.full((3, 3), np.nan))
    assert view.picture.shape == (180, 240)
    assert not any(view.outlines_px.values())
    assert len(view.subsets_px) == len(view.displacement_m) == 0
    messages = {topic: content() for topic, content in shown(view).items()}
    assert len(messages["view/regions"].points) == 0
    assert len(messages["view/displacement"].points) == 0
    assert [marker.action for marker in messages["view/scene"].markers] == [3]


def test_the_colour_scale_grows_until_another_reference_comes() -> None:
    scale = ColourScale()
    scale.widen(1, np.array([0.0, 2e-4]))
    wide = scale.limit_m
    assert wide == pytest.approx(2e-4, rel=0.02)
    scale.widen(1, np.array([0.0, 1e-5]))
    assert scale.limit_m == wide
    np.testing.assert_allclose(scale.colours(np.array([-1.0, 0.0, 1.0])), [BLUE, WHITE, RED])
    scale.widen(2, np.array([1e-5]))
    assert scale.limit_m == pytest.approx(1e-5)


def test_the_nearest_plane() -> None:
    other = Plane(NORMAL, -1.3, np.zeros((4, 4)))
    planes = [
        PlaneEstimate(0, FrameStatus.OK, plane=other),
        PlaneEstimate(50_000_000, FrameStatus.OK, plane=PLANE),
        PlaneEstimate(60_000_000, FrameStatus.NO_PLANE),
    ]
    assert nearest_plane(planes, 61_000_000) is PLANE
    assert nearest_plane(planes, 151_000_000) is None
    assert nearest_plane([], 0) is None


def test_parts_of_one_image_are_put_together_in_any_order() -> None:
    together = SameStamp("picture", {"field": 1, "opening": 2}, late=2)
    assert together.add("field", 1, "f1") is None
    assert together.add("picture", 1, "p1") is None
    assert together.add("opening", 2, "o2") is None
    assert together.add("opening", 1, "o1") == {"picture": "p1", "field": "f1", "opening": "o1"}
    for stamp in (3, 4, 5):  # two are kept, so that of 2 is gone
        together.add("opening", stamp, f"o{stamp}")
    together.add("field", 2, "f2")
    assert together.add("picture", 2, "p2") is None
    for stamp in (6, 7):  # two pictures wait, so that of 2 is given up
        together.add("picture", stamp, f"p{stamp}")
    assert together.add("opening", 2, "o2") is None


def test_a_single_viewer_that_confirms_nothing_is_gone_until_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    now, output = [0.0], SimpleNamespace(matched=0, confirmed=lambda: True)
    monkeypatch.setattr("rgbd_dic_processing.nodes.attended.time", SimpleNamespace(monotonic=lambda: now[0]))
    attended = Attended(output)

    def after(seconds: float, matched: int, confirmed: bool) -> bool:
        now[0] += seconds
        output.matched, output.confirmed = matched, lambda: confirmed
        return attended.now()

    assert not after(0.0, 0, True)
    assert after(100.0, 1, False)  # it has just come
    assert after(GONE_S - 0.1, 1, False)
    assert not after(0.2, 1, False)
    assert after(5.0, 1, True)
    assert not after(GONE_S + 0.1, 1, False)
    assert after(0.1, 2, False)  # another has come, and one of the two is there
    assert after(100.0, 2, False)
    assert after(0.1, 1, False)  # which of them left is not known
    assert not after(GONE_S + 0.1, 1, False)
    assert not after(0.1, 0, True)


def shown(view: View, status: FrameStatus = FrameStatus.OK, most: int = 1500) -> dict:
    scale = ColourScale()
    scale.widen(1, view.displacement_m[:, 0])
    settings = ViewerSettings(most_marks=most)
    return view_messages(make_message, 100, "camera_optical_frame", view, scale, opening(status), settings)


def through_a_bag(message):
    """What a reader of the bytes finds."""
    return typestore().deserialize_cdr(serialise(message), message.__msgtype__)


def test_messages_hold_what_the_view_does() -> None:
    view = view_of(PLANE.moved(R, T), small=np.arange(180 * 240, dtype=np.uint8).reshape(180, 240))
    messages = {topic: through_a_bag(content()) for topic, content in shown(view).items()}
    assert {(m.header.stamp.nanosec, m.header.frame_id) for t, m in messages.items() if t != "view/scene"} == {
        (100, "camera_optical_frame")
    }
    np.testing.assert_array_equal(messages["view/image_rect"].data, view.picture.ravel())
    assert messages["view/camera_info"].k[0] == view.camera.fx == 410 and not messages["view/camera_info"].d.any()
    lines = messages["view/regions"]
    edges = np.array([[point.x, point.y] for point in lines.points]).reshape(-1, 2, 2) - 0.5
    assert len(lines.outline_colors) == len(edges) == 4 + 4 + 3 + 4 + 4 + 1  # of the crack, one
    np.testing.assert_allclose(edges[:4, 0], view.outlines_px["panel"][0])
    np.testing.assert_allclose(edges[:4, 1], np.roll(view.outlines_px["panel"][0], -1, axis=0))
    np.testing.assert_allclose(edges[-1], view.outlines_px["crack"][0])
    marks = messages["view/displacement"]
    np.testing.assert_allclose([[p.x - 0.5, p.y - 0.5] for p in marks.points], view.subsets_px)
    moved = view.displacement_m[:, 0] > APART_M / 2
    colours = np.array([[c.r, c.g, c.b] for c in marks.outline_colors])
    np.testing.assert_allclose(colours[moved], np.broadcast_to(RED, (moved.sum(), 3)), atol=0.01)
    np.testing.assert_allclose(colours[~moved], np.broadcast_to(WHITE, ((~moved).sum(), 3)), atol=0.01)


def test_the_cloud_of_subsets_has_position_displacement_and_colour() -> None:
    view = view_of(PLANE.moved(R, T))
    message = through_a_bag(shown(view)["view/subsets"]())
    np.testing.assert_allclose(points_from_message(message), view.subsets_m, rtol=1e-6)
    kinds = {7: "<f4", 6: "<u4"}
    points = np.frombuffer(message.data, [(field.name, kinds[field.datatype]) for field in message.fields])
    np.testing.assert_allclose(points["normal"], view.displacement_m[:, 0], rtol=1e-6)
    np.testing.assert_allclose(points["sigma"], view.sigma_m, rtol=1e-6)
    red = round(255 * RED[0]) << 16 | round(255 * RED[1]) << 8 | round(255 * RED[2])
    assert (points["rgb"][view.displacement_m[:, 0] > APART_M / 2] == red).all()


def test_the_scene_is_drawn_anew_each_time() -> None:
    plane = PLANE.moved(R, T)
    markers = through_a_bag(shown(view_of(plane))["view/scene"]()).markers
    assert [marker.action for marker in markers] == [3] + [0] * (len(markers) - 1)
    assert len({(marker.ns, marker.id) for marker in markers[1:]}) == len(markers) - 1
    assert all(marker.pose.orientation.w == 1 for marker in markers[1:])
    by_name = {marker.ns: marker for marker in markers}
    assert set(by_name) == {"", "plane", "panel", "fixed", "fixed_holes", "left", "right", "crack", "opening"}
    corners = np.array([[p.x, p.y, p.z] for p in by_name["plane"].points])
    np.testing.assert_allclose(corners @ plane.normal + plane.d, 0, atol=1e-12)
    sides = corners[:, :2].reshape(-1, 3, 2).astype(np.float32)
    outline = view_of(plane).outlines_m["panel"][0][:, :2].astype(np.float32)
    assert sum(cv2.contourArea(side) for side in sides) == pytest.approx(cv2.contourArea(outline), rel=1e-4)
    assert by_name["opening"].text == "opening +0.500 mm, u 0.004 mm"
    invalid = through_a_bag(shown(view_of(plane), FrameStatus.LOST)["view/scene"]()).markers[-1]
    assert invalid.text == "invalid: too dark"


def test_fewer_marks_than_subsets() -> None:
    view = view_of(PLANE)
    assert len(shown(view, most=50)["view/displacement"]().points) == pytest.approx(45, abs=5)


def test_the_band_is_in_millimetres() -> None:
    band = through_a_bag(band_message(make_message, opening(), "panel"))
    told = (band.opening_mm, band.lower_mm, band.upper_mm, band.u_opening_mm, band.sliding_mm)
    assert told == pytest.approx((0.5, 0.496, 0.504, 0.004, 0.1))
    assert np.isnan(band_message(make_message, opening(FrameStatus.LOST), "panel").lower_mm)


def test_the_cloud_knows_how_far_behind_the_plane_it_is() -> None:
    points = PLANE.points(CAMERA.rays(np.random.default_rng(1).uniform(0, 300, (1000, 2)))) + 0.01 * NORMAL
    message = through_a_bag(cloud_message(make_message, 5, "camera_optical_frame", points, PLANE))
    columns = np.frombuffer(message.data, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(columns[:, :3], points, rtol=1e-6)
    np.testing.assert_allclose(columns[:, 3], 0.01, atol=1e-6)


def test_of_a_depth_image_every_so_manieth_row_and_column_is_shown() -> None:
    """A wall at 2 m before a ToF sensor that is turned by 90 degrees about z and stands 0.1 m before the camera."""
    tof = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
    turned = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    calibration = Calibration(CAMERA, tof, turned, np.array([0.0, 0.0, 0.1]))
    viewer = Viewer(make_message, calibration, ViewerSettings(most_points=200))
    depth = np.full((48, 64), 2.0, np.float32)
    depth[0, 0] = np.nan
    message = through_a_bag(viewer.cloud_of_depth(5, "camera_optical_frame", depth))
    points = points_from_message(message)
    assert len(points) == 16 * 12 - 1  # every fourth
    np.testing.assert_allclose(points[:, 2], 2.1, rtol=1e-6)
    seen = {tuple(p) for p in np.round(tof.project((points - [0, 0, 0.1]) @ turned)).astype(int).tolist()}
    assert seen == {(x, y) for x in range(0, 64, 4) for y in range(0, 48, 4)} - {(0, 0)}
    with pytest.raises(ImageError, match="64 x 48"):
        viewer.cloud_of_depth(5, "camera_optical_frame", depth[:10])
    with pytest.raises(CalibrationError, match="tof"):
        Viewer(make_message, Calibration(CAMERA), ViewerSettings()).cloud_of_depth(5, "", depth)
