"""Old recordings become bags: what is written, what is assumed and said, what is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from plyfile import PlyData, PlyElement
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration, Camera, load_calibration
from rgbd_dic_acquisition.errors import BagError, CalibrationError, ImageError
from rgbd_dic_acquisition.recordings import import_recording

from rgbd_dic_acquisition import messages

REAL_DATA = Path(__file__).parents[4] / "shared" / "data"
CAMERA = Camera(60, 40, 100.0, 101.0, 29.5, 19.5, 0.01, 0.02)
TOF = Camera(30, 20, 50.0, 50.0, 14.5, 9.5)
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def save(folder, name, pixels):
    folder.mkdir(exist_ok=True)
    if name.endswith(".npy"):
        np.save(folder / name, pixels)
    elif name.endswith(".ply"):
        rows = np.array([tuple(point) for point in pixels], [("x", "f4"), ("y", "f4"), ("z", "f4")])
        PlyData([PlyElement.describe(rows, "vertex")]).write(folder / name)
    else:
        assert cv2.imwrite(str(folder / name), pixels)


@pytest.fixture
def images(tmp_path):
    """Eleven 8-bit images, whose names sort otherwise by letters (img10 before img2)."""
    for k in range(11):
        save(tmp_path / "images", f"img{k}.png", np.full((40, 60), 10 * k, np.uint8))
    return tmp_path / "images"


def read(path):
    """Messages of a bag by topic, in the order of time."""
    found = {}
    with BagReader(path) as bag:
        for topic, log_ns, msg in bag.messages():
            found.setdefault(topic, []).append(msg)
            if topic != "/tf_static":
                assert messages.stamp_to_ns(msg.header.stamp) == log_ns
    return found


def stamps_of(found, topic):
    return [messages.stamp_to_ns(msg.header.stamp) for msg in found[topic]]


def write_stamps(path, header, rows):
    path.write_text("\n".join([header, *(f"{name},{stamp}" for name, stamp in rows)]) + "\n")
    return path


def test_images_alone(images, tmp_path):
    """Natural order, a plane at the distance where a pixel is a millimetre, and all of it is said."""
    seen = []
    summary = import_recording(images, tmp_path / "bag", frame_rate_hz=10.0, progress=lambda *step: seen.append(step))
    found = read(summary.path)
    assert [messages.image_from_message(msg)[0, 0] for msg in found["/camera/image_raw"]] == [10 * k for k in range(11)]
    assert stamps_of(found, "/camera/image_raw") == [10**9 + k * 10**8 for k in range(11)]
    assert stamps_of(found, "/tof/depth/image_raw") == stamps_of(found, "/camera/camera_info")
    camera = Camera.from_camera_info(found["/camera/camera_info"][0])
    assert camera == Camera(60, 40, 60.0, 60.0, 29.5, 19.5)
    depth = messages.depth_from_message(found["/tof/depth/image_raw"][0])
    np.testing.assert_allclose(depth, 0.06, rtol=1e-6)
    tof = Camera.from_camera_info(found["/tof/depth/camera_info"][0])
    assert (tof.height, tof.width) == depth.shape
    calibration = load_calibration(tmp_path / "bag" / "calibration.yaml")
    assert (calibration.camera, calibration.tof) == (camera, tof)
    assert summary.counts["/camera/image_raw"] == 11 and summary.counts["/tf_static"] == 1
    text = " | ".join(summary.notes)
    for part in ("10 images a second", "focal length 60 px", "1 mm in the results is 1 pixel"):
        assert part in text
    assert seen == [(k, 11) for k in range(1, 12)]


def test_distance_and_calibration_are_taken(images, tmp_path):
    summary = import_recording(
        images, tmp_path / "bag", distance_m=1.2345, calibration=Calibration(CAMERA), compression="zstd"
    )
    found = read(summary.path)
    assert Camera.from_camera_info(found["/camera/camera_info"][3]) == CAMERA
    depth = messages.depth_from_message(found["/tof/depth/image_raw"][3])
    np.testing.assert_allclose(depth, 1.2345, rtol=1e-6)  # to float32, not to whole millimetres
    assert any("constant plane squarely in front of the camera at 1.2345 m" in note for note in summary.notes)
    assert not any("no calibration" in note for note in summary.notes)


def test_sixteen_bits_get_one_scale_for_all_images(tmp_path):
    """A ramp from 1000 to 2000 and a second image half as bright: the ratio of the two must survive."""
    ramp = np.linspace(1000, 2000, 2400).reshape(40, 60).round().astype(np.uint16)
    save(tmp_path / "images", "a.tiff", ramp)
    save(tmp_path / "images", "b.tif", np.full((40, 60), 1500, np.uint16))
    seen = []
    summary = import_recording(tmp_path / "images", tmp_path / "bag", progress=lambda *step: seen.append(step))
    found = read(summary.path)
    first, second = (messages.image_from_message(msg) for msg in found["/camera/image_raw"])
    np.testing.assert_allclose(first, (ramp - 1000.0) * 0.255, atol=1.5)  # 0.1 % is cut off at both ends
    np.testing.assert_allclose(second, 127.5, atol=1.5)
    assert any(note.startswith("16 bits scaled to 8: grey level 100") for note in summary.notes)
    assert seen[-1] == (4, 4)


def test_colour_becomes_grey(tmp_path):
    save(tmp_path / "images", "a.png", np.full((40, 60, 3), 77, np.uint8))
    save(tmp_path / "images", "b.png", np.broadcast_to(np.uint8([200, 100, 50]), (40, 60, 3)))
    found = read(import_recording(tmp_path / "images", tmp_path / "bag").path)
    grey = [int(messages.image_from_message(msg)[0, 0]) for msg in found["/camera/image_raw"]]
    assert grey == [77, round(0.114 * 200 + 0.587 * 100 + 0.299 * 50)]


@pytest.mark.parametrize(
    ("name", "values", "expected_m"),
    [
        ("d.png", np.uint16([[0, 1500]]), [np.nan, 1.5]),
        ("d.npy", np.int32([[-3, 1500]]), [np.nan, 1.5]),
        ("d.npy", np.float64([[np.inf, 1.50025]]), [np.nan, 1.50025]),
    ],
)
def test_depth_files_in_their_units(tmp_path, name, values, expected_m):
    save(tmp_path / "images", "a.png", np.zeros((40, 60), np.uint8))
    save(tmp_path / "depth", name, np.tile(values, (20, 15)))
    calibration = Calibration(CAMERA, TOF, TURN, np.array([0.1, 0.2, 0.3]))
    summary = import_recording(tmp_path / "images", tmp_path / "bag", depth=tmp_path / "depth", calibration=calibration)
    found = read(summary.path)
    depth = messages.depth_from_message(found["/tof/depth/image_raw"][0])
    np.testing.assert_allclose(depth, np.tile(expected_m, (20, 15)), rtol=1e-6)
    assert Camera.from_camera_info(found["/tof/depth/camera_info"][0]) == TOF
    assert found["/tf_static"][0].transforms[0].transform.translation.y == 0.2


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "metres"), (1000.0, "millimetres")])
def test_clouds_in_their_units(tmp_path, scale, unit):
    points = np.array([[0.1, 0.2, 1.5], [np.nan, 0.0, 1.0], [0.3, -0.2, 1.6]])
    save(tmp_path / "images", "a.png", np.zeros((40, 60), np.uint8))
    save(tmp_path / "depth", "a.ply", points * scale)
    summary = import_recording(tmp_path / "images", tmp_path / "bag", depth=tmp_path / "depth")
    (cloud,) = read(summary.path)["/tof/points"]
    np.testing.assert_allclose(messages.points_from_message(cloud), points[[0, 2]], rtol=1e-6)
    assert f"clouds are in {unit}" in summary.notes
    assert any("camera's optical frame" in note for note in summary.notes)


def test_depth_of_the_images_size_is_taken_as_aligned(tmp_path):
    save(tmp_path / "images", "a.png", np.zeros((40, 60), np.uint8))
    save(tmp_path / "depth", "a.png", np.full((40, 60), 900, np.uint16))
    summary = import_recording(tmp_path / "images", tmp_path / "bag", depth=tmp_path / "depth")
    assert any("aligned with the images" in note for note in summary.notes)
    calibration = load_calibration(summary.path / "calibration.yaml")
    assert calibration.tof == calibration.camera
    np.testing.assert_array_equal(calibration.R_camera_tof, np.eye(3))


def test_stamps_of_images_and_of_depth(images, tmp_path):
    """To the nanosecond, names with or without suffix, rows in any order; fewer depth files than images."""
    rows = [(f"img{k}.png" if k % 2 else f"img{k}", f"1700000000.{k:02d}0000001") for k in range(11)]
    stamps = write_stamps(tmp_path / "s.csv", "image,stamp_s", rows[::-1])
    for k in range(3):
        save(tmp_path / "depth", f"d{k}.png", np.full((40, 60), 900 + k, np.uint16))
    depth_stamps = write_stamps(
        tmp_path / "d.csv", "depth,stamp_s", [(f"d{k}.png", 1700000000.025 + 0.05 * k) for k in range(3)]
    )
    summary = import_recording(
        images, tmp_path / "bag", depth=tmp_path / "depth", stamps=stamps, depth_stamps=depth_stamps
    )
    found = read(summary.path)
    second = 1_700_000_000 * 10**9
    assert stamps_of(found, "/camera/image_raw") == [second + k * 10**7 + 1 for k in range(11)]
    assert len(found["/tof/depth/image_raw"]) == 3
    assert stamps_of(found, "/tof/depth/image_raw")[1] == second + 75_000_000


def test_stamps_from_zero_are_moved_and_it_is_said(images, tmp_path):
    stamps = write_stamps(tmp_path / "s.csv", "image,stamp_s", [(f"img{k}.png", k / 10) for k in range(11)])
    summary = import_recording(images, tmp_path / "bag", stamps=stamps)
    assert stamps_of(read(summary.path), "/camera/image_raw")[0] == 10**9
    assert any("moved by 1 s" in note for note in summary.notes)


@pytest.mark.parametrize(
    ("header", "rows", "text"),
    [
        ("image,time", [("img0.png", 1)], "must be a CSV with the header image,stamp_s"),
        (
            "image,stamp_s",
            [(f"img{k}.png", k) for k in range(10)],
            "10 rows for 11 files: no row for img10.png",
        ),
        (
            "image,stamp_s",
            [(f"img{k}.png", k) for k in range(12)],
            "12 rows for 11 files: rows that belong to no",
        ),
        ("image,stamp_s", [(f"img{k}.png", -k) for k in range(11)], "must increase .* img1.png at -1.0"),
        ("image,stamp_s", [(f"img{k}.png", k - 5) for k in range(11)], "stamp -5.0+ s is before 0"),
        ("image,stamp_s", [("img0.png", "noon")], "line 2: stamp_s = 'noon' is no number"),
        ("image,stamp_s", [("img0.png", "nan")], "line 2: stamp_s = 'nan' is no number"),
    ],
)
def test_bad_stamps_are_refused(images, tmp_path, header, rows, text):
    stamps = write_stamps(tmp_path / "s.csv", header, rows)
    with pytest.raises(ImageError, match=text):
        import_recording(images, tmp_path / "bag", stamps=stamps)
    assert not (tmp_path / "bag").exists()


def test_bad_folders_and_files_are_refused_and_leave_nothing_behind(images, tmp_path):
    def refused(text, error=ImageError, **options):
        with pytest.raises(error, match=text):
            import_recording(options.pop("images", images), tmp_path / "bag", **options)
        assert not (tmp_path / "bag").exists()

    refused("is not a folder", images=tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    refused(r"has no image files \(.png, .tif, .tiff\)", images=tmp_path / "empty")
    refused("has no depth files", depth=tmp_path / "empty")
    refused("must be above 0", frame_rate_hz=0.0)
    refused("must be between 0.01 and 1000 m", CalibrationError, distance_m=-1.0)
    refused("uncalibrated camera", CalibrationError, focal_px=0.0)
    refused("images of 30 x 20 pixels, the recording has 60 x 40", CalibrationError, calibration=Calibration(TOF))
    save(tmp_path / "depth", "d0.png", np.full((20, 30), 900, np.uint16))
    refused("1 depth files for 11 images", depth=tmp_path / "depth")
    refused("both depth files and a distance", depth=tmp_path / "depth", distance_m=1.0)
    refused("depth stamps without depth files", depth_stamps=tmp_path / "d.csv")
    for k in range(1, 11):
        save(tmp_path / "depth", f"d{k}.png", np.full((20, 30), 900, np.uint16))
    refused("30 x 20 pixels need a calibration with 'tof'", CalibrationError, depth=tmp_path / "depth")
    both = Calibration(CAMERA, TOF)
    save(tmp_path / "depth", "d7.png", np.full((21, 30), 900, np.uint16))
    refused("d7.png has 30 x 21 pixels, unlike the first", depth=tmp_path / "depth", calibration=both)
    save(tmp_path / "depth", "d7.png", np.zeros((20, 30), np.uint16))
    refused("d7.png has no valid depth", depth=tmp_path / "depth", calibration=both)
    save(tmp_path / "depth", "d7.png", np.full((20, 30), 9, np.uint8))
    refused("d7.png is uint8: a depth PNG must have", depth=tmp_path / "depth", calibration=both)
    (tmp_path / "depth" / "d7.png").unlink()
    save(tmp_path / "depth", "d7.npy", np.full((20, 30), 900.0))
    refused("d7.npy has a median depth of 900 m: a float .npy", depth=tmp_path / "depth", calibration=both)
    (images / "img5.png").write_bytes(b"not a picture")
    refused("img5.png cannot be read as an image")
    save(images, "img5.png", np.zeros((40, 61), np.uint8))
    refused("img5.png has 61 x 40 pixels of 8 bits, but the first image 60 x 40 pixels of 8 bits")
    save(images, "img5.png", np.zeros((40, 60), np.uint16))
    refused("img5.png has 60 x 40 pixels of 16 bits, but the first")


def test_existing_bag_is_kept(images, tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "mine.txt").write_text("mine")
    with pytest.raises(BagError, match="exists already"):
        import_recording(images, tmp_path / "bag")
    assert (tmp_path / "bag" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(("name", "shape", "bits"), [("real_crack", (1228, 800), 16), ("open_hole", (1040, 400), 8)])
def test_real_recordings(tmp_path, name, shape, bits):
    folder = REAL_DATA / name
    if not folder.is_dir():
        pytest.skip(f"the images of {name} are not in ../shared/data beside the project")
    summary = import_recording(folder, tmp_path / name)
    images = [messages.image_from_message(msg) for msg in read(summary.path)["/camera/image_raw"]]
    assert len(images) == 12 and {image.shape for image in images} == {shape}
    assert any("16 bits scaled" in note for note in summary.notes) == (bits == 16)
    for image, file in zip(images, sorted(folder.glob("*.*")), strict=True):
        original = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        saturated = np.mean((original == 0) | (original == 2**bits - 1))
        assert image.std() > 25  # contrast for the DIC
        assert np.mean((image == 0) | (image == 255)) < saturated + 0.01  # of all images: 0.002
