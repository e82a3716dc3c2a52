"""The regions page in a real browser: every region drawn with the mouse, saved, and the sample bag measured with it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import TABLET, chromium_page, needs_chromium, serious_findings, serving
from playwright.sync_api import expect
from rgbd_dic_processing.results import read_openings, read_truth
from system import SAMPLE, rgbd_dic

pytestmark = needs_chromium

PANEL = [(41, 68), (387, 68), (387, 311), (36, 306)]  # px, as in bags/sample/regions.yaml
FIXED = [(41, 68), (187, 68), (184, 308), (36, 306)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample without its regions."""
    folder = tmp_path_factory.mktemp("drawn") / "sample"
    folder.mkdir()
    for path in SAMPLE.iterdir():
        if path.name != "regions.yaml":
            (folder / path.name).symlink_to(path)
    return folder


@pytest.fixture
def drawn(bag: Path, tmp_path: Path) -> Iterator:
    """The page on the sample, and the file that it saves."""
    out = tmp_path / "regions.yaml"
    with serving("regions", bag, "--out", out, "--port", 0) as address, chromium_page() as page:
        page.goto(address)
        page.wait_for_selector("#shapes g", state="attached")
        yield page, out


class Hand:
    """Draws on the page in pixels of the image."""

    def __init__(self, page):
        self.page = page

    def view(self) -> tuple[float, float, float]:
        """Where the image's first pixel is on the screen, and the size of a pixel there."""
        moved = self.page.locator("#shapes > g").get_attribute("transform")
        x, y, scale = map(float, re.match(r"translate\(([-\d.e]+) ([-\d.e]+)\) scale\(([\d.e]+)\)", moved).groups())
        box = self.page.locator("#view").bounding_box()
        return box["x"] + x, box["y"] + y, scale

    def at(self, point: tuple[float, float]) -> tuple[float, float]:
        """Where a point of the image is on the screen."""
        x, y, scale = self.view()
        return x + point[0] * scale, y + point[1] * scale

    def to_image(self, at: tuple[float, float]) -> tuple[float, float]:
        x, y, scale = self.view()
        return (at[0] - x) / scale, (at[1] - y) / scale

    def wait_until_drawn(self) -> None:
        """The page draws what was done in the next frame of the browser."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def choose(self, tool: str) -> None:
        self.page.get_by_role("button", name=tool, exact=True).click()

    def polygon(self, tool: str, points: list[tuple[float, float]]) -> None:
        self.choose(tool)
        for point in [*points, points[0]]:
            self.page.mouse.click(*self.at(point))

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.page.mouse.move(*self.at(start))
        self.page.mouse.down()
        self.page.mouse.move(*self.at(((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)))
        self.page.mouse.move(*self.at(end))
        self.page.mouse.up()

    def save(self, out: Path) -> dict:
        expect(self.page.locator("#save")).to_be_enabled()
        with self.page.expect_response("**/regions/save") as answer:
            self.choose("Save")
        assert answer.value.ok
        return yaml.safe_load(out.read_text())


def test_every_region_is_drawn_with_the_mouse_and_measures(drawn, bag: Path, tmp_path: Path) -> None:
    """The opening from the drawn file is as near to the truth as that from the sample's own: 0.005 mm RMS there, with a
    stated uncertainty of 0.004 mm; 0.01 mm leaves room for zones of another size."""
    page, out = drawn
    hand = Hand(page)
    hand.polygon("Panel", PANEL)
    hand.polygon("Fixed region", FIXED)
    hand.polygon("Hole", [(60, 90), (100, 90), (80, 130)])
    hand.choose("Two rectangles")
    hand.drag((295, 247), (236, 128))  # the right one first, from its lower right corner
    hand.drag((126, 128), (185, 247))
    hand.choose("x axis")
    hand.drag((38, 186), (387, 188))
    saved = hand.save(out)
    np.testing.assert_allclose(saved["panel"], PANEL, atol=0.7)  # a click lies on a whole pixel of the screen
    np.testing.assert_allclose(saved["fixed"], [FIXED], atol=0.7)
    np.testing.assert_allclose(saved["x_axis"], [(38, 186), (387, 188)], atol=0.7)
    np.testing.assert_allclose(saved["crack"]["left"], [126, 128, 185, 247], atol=0.7)
    np.testing.assert_allclose(saved["crack"]["right"], [236, 128, 295, 247], atol=0.7)
    assert len(saved["fixed_holes"]) == 1
    assert "mm" in page.locator("#sizes").inner_text() and not page.locator("#no-sizes").inner_text()
    run = tmp_path / "run"
    done = rgbd_dic("process", bag, "--regions", out, "--out", run)
    assert done.returncode == 0, done.stderr
    truth = read_truth(bag / "truth.csv")
    openings = read_openings(run / "crack_opening.csv")
    true_m = dict(zip(truth.stamps_ns.tolist(), truth.jump_m[:, 0], strict=True))
    error = np.array([opening.opening_m - true_m[opening.stamp_ns] for opening in openings])
    assert len(openings) == 120 and all(opening.valid for opening in openings)
    assert np.sqrt(np.mean((error - error[0]) ** 2)) < 1e-5


def test_zones_by_a_point_are_changed_by_their_handles(drawn) -> None:
    page, out = drawn
    hand = Hand(page)
    hand.polygon("Panel", PANEL)
    hand.polygon("Fixed region", FIXED)
    hand.choose("Zones by a point")
    hand.drag((210, 187), (210, 247))
    crack = hand.save(out)["crack"]
    np.testing.assert_allclose(crack["point"], (210, 187), atol=0.7)
    np.testing.assert_allclose(crack["direction"], (0, 1), atol=0.02)
    assert crack["gap"] == 16  # half a subset of 31 px, so that none reaches over the crack
    assert crack["size"] == pytest.approx([60, 120], abs=1.5)
    width = page.get_by_role("button", name=re.compile("Measuring zones, width"))
    width.focus()
    for _ in range(3):
        page.keyboard.press("Shift+ArrowLeft")
    assert page.evaluate("document.activeElement.id") == "crack-2"  # the focus stays on what is moved
    changed = hand.save(out)["crack"]
    assert changed["size"][0] == pytest.approx(crack["size"][0] - 30, abs=0.11) and changed["gap"] == crack["gap"]
    hand.drag((210, 187), (220, 180))
    np.testing.assert_allclose(hand.save(out)["crack"]["point"], (220, 180), atol=0.7)
    for _ in range(4):
        page.keyboard.press("Control+z")
    assert hand.save(out)["crack"] == crack


def test_what_cannot_work_is_refused_with_its_reason(drawn) -> None:
    page, out = drawn
    hand, refusals = Hand(page), page.locator("#refusals")
    hand.polygon("Panel", PANEL)
    hand.polygon("Fixed region", [(60, 90), (360, 90), (360, 290), (60, 290)])
    hand.choose("Zones by a point")
    hand.drag((210, 187), (210, 247))
    expect(page.locator("#refusals")).to_contain_text("across the crack line")
    assert page.get_by_role("button", name="Save").is_disabled() and not out.exists()
    page.get_by_role("button", name="Remove Fixed region").click()
    expect(page.locator("#warnings")).to_contain_text("h_joint")
    assert not refusals.inner_text() and page.get_by_role("button", name="Save").is_enabled()
    page.get_by_role("button", name="Remove Measuring zones").click()
    hand.choose("Two rectangles")
    hand.drag((20, 320), (34, 340))  # both outside the panel
    hand.drag((400, 320), (420, 340))
    expect(page.locator("#refusals")).to_contain_text("holds no subset centre")
    answer = page.request.post(
        page.url.replace("/regions", "/regions/save"), data={"entries": {"panel": [[0, 0], [5, 0], [5, 5]]}}
    )
    assert answer.status == 422 and "no whole subset" in answer.json()["error"] and not out.exists()


def test_an_old_file_is_loaded_and_a_broken_one_refused(drawn, tmp_path: Path) -> None:
    page, out = drawn
    page.locator("#file").set_input_files(SAMPLE / "regions.yaml")
    expect(page.locator("#said")).to_contain_text("is loaded")
    old = yaml.safe_load((SAMPLE / "regions.yaml").read_text())
    assert Hand(page).save(out) == old
    broken = tmp_path / "broken.yaml"
    broken.write_text("panel: [[0, 0]]")
    with page.expect_response("**/regions/read") as answer:
        page.locator("#file").set_input_files(broken)
    assert answer.value.status == 422
    expect(page.locator("#said")).to_contain_text("at least 3 points")
    assert Hand(page).save(out) == old


def test_regions_are_drawn_without_a_mouse(drawn) -> None:
    page, out = drawn
    page.get_by_role("button", name="Panel", exact=True).focus()
    page.keyboard.press("Enter")
    page.locator("#view").focus()
    page.keyboard.press("ArrowRight")  # the cross appears in the middle
    for key, times in (("ArrowLeft", 15), ("ArrowUp", 8)):
        for _ in range(times):
            page.keyboard.press(f"Shift+{key}")
    page.keyboard.press("Space")
    for key, times in (("ArrowRight", 30), ("ArrowDown", 18), ("ArrowLeft", 30)):
        for _ in range(times):
            page.keyboard.press(f"Shift+{key}")
        page.keyboard.press("Space")
    page.keyboard.press("Enter")
    corners = np.array(Hand(page).save(out)["panel"])
    np.testing.assert_allclose(corners - corners[0], [(0, 0), (300, 0), (300, 180), (0, 180)], atol=0.11)


def test_undo_takes_back_points_while_drawing_and_then_changes(drawn) -> None:
    page, out = drawn
    hand, undo, redo = Hand(page), *(page.get_by_role("button", name=name, exact=True) for name in ("Undo", "Redo"))
    assert undo.is_disabled() and redo.is_disabled()
    hand.choose("Panel")
    for point in [*PANEL[:2], (200, 200)]:
        page.mouse.click(*hand.at(point))
    undo.click()  # the last of the three points
    for point in [*PANEL[2:], PANEL[0]]:
        page.mouse.click(*hand.at(point))
    np.testing.assert_allclose(hand.save(out)["panel"], PANEL, atol=0.7)
    hand.polygon("Fixed region", FIXED)
    listed = page.locator("#shapes-list")
    expect(listed).to_contain_text("Fixed region")
    page.keyboard.press("Control+z")
    expect(listed).not_to_contain_text("Fixed region")
    undo.click()
    expect(listed).to_be_empty()
    assert undo.is_disabled()
    for _ in range(2):
        page.keyboard.press("Control+Shift+z")
    assert redo.is_disabled()
    saved = hand.save(out)
    np.testing.assert_allclose([*saved["panel"], *saved["fixed"][0]], [*PANEL, *FIXED], atol=0.7)


def test_each_region_has_its_size_and_what_is_not_saved_is_asked_for(drawn) -> None:
    """The panel is 350 px wide at 1.47 mm a pixel, as the sample's distance and focal length have it."""
    page, out = drawn
    hand, asked = Hand(page), []
    hand.polygon("Panel", PANEL)
    hand.polygon("Fixed region", FIXED)
    size = page.locator("#size-panel")
    expect(size).to_contain_text("mm")
    width, height = (float(word) for word in re.findall(r"\d+", size.inner_text()))
    assert width == pytest.approx(350 * 1.47, rel=0.03) and height == pytest.approx(242 * 1.47, rel=0.03)
    expect(page.locator("#size-fixed0")).to_contain_text("mm")

    def answer(dialog) -> None:
        asked.append(dialog.type)
        dialog.dismiss()

    page.on("dialog", answer)
    leave = "setTimeout(() => location.reload())"
    page.evaluate(leave)
    page.wait_for_timeout(500)
    assert asked == ["beforeunload"]
    hand.save(out)
    with page.expect_navigation():
        page.evaluate(leave)
    assert asked == ["beforeunload"]


def test_fingers_draw_and_zoom(bag: Path, tmp_path: Path) -> None:
    options = ("--out", tmp_path / "regions.yaml", "--port", 0)
    with serving("regions", bag, *options) as address, chromium_page(TABLET, fingers=True) as page:
        page.goto(address)
        page.wait_for_selector("#shapes g", state="attached")
        hand = Hand(page)
        page.get_by_role("button", name="Panel", exact=True).tap()
        for point in [*PANEL, PANEL[0]]:
            page.touchscreen.tap(*hand.at(point))
        np.testing.assert_allclose(hand.save(tmp_path / "regions.yaml")["panel"], PANEL, atol=0.7)
        session, scale = page.context.new_cdp_session(page), hand.view()[2]
        left, right = hand.at((150, 150)), hand.at((250, 150))
        apart = (right[0] + 0.5 * (right[0] - left[0]), right[1])
        for kind, points in (("Start", (left, right)), ("Move", (left, apart)), ("End", ())):
            touched = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
            session.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": touched})
        page.wait_for_timeout(100)
        assert hand.view()[2] == pytest.approx(1.5 * scale, rel=0.02)
        np.testing.assert_allclose(hand.to_image(left), (150, 150), atol=1.0)
        np.testing.assert_allclose(hand.to_image(apart), (250, 150), atol=1.0)


def test_zoom_and_pan_keep_to_the_image(drawn) -> None:
    page, _ = drawn
    hand = Hand(page)
    fitted = hand.at((100, 100))
    corner = tuple(map(round, fitted))
    under = hand.to_image(corner)
    page.mouse.move(*corner)
    page.mouse.wheel(0, -500)
    hand.wait_until_drawn()
    np.testing.assert_allclose(hand.at(under), corner, atol=0.01)  # what is under the pointer stays there
    page.mouse.down()
    page.mouse.move(corner[0] + 40, corner[1] - 30)
    page.mouse.up()
    hand.wait_until_drawn()
    np.testing.assert_allclose(hand.at(under), np.add(corner, (40, -30)), atol=0.01)
    scale = hand.view()[2]
    hand.choose("Zoom in")
    hand.wait_until_drawn()
    assert hand.view()[2] > 1.05 * scale
    hand.choose("Zoom out")
    hand.wait_until_drawn()
    assert hand.view()[2] == pytest.approx(scale)
    hand.choose("Fit")
    hand.wait_until_drawn()
    np.testing.assert_allclose(hand.at((100, 100)), fitted, atol=0.01)


def test_accessibility_has_no_serious_finding(bag: Path, tmp_path: Path) -> None:
    with (
        serving(
            "regions", bag, "--regions", SAMPLE / "regions.yaml", "--out", tmp_path / "r.yaml", "--port", 0
        ) as address,
        chromium_page(TABLET) as page,
    ):
        page.goto(address)
        expect(page.locator("#verdict")).to_have_class("fine")
        page.get_by_role("button", name="Measuring zones", exact=True).click()
        assert serious_findings(page) == []
