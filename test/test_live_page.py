"""The live page in a real browser, on a graph that plays a bag: it shows what is published, and its buttons act."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import LAPTOP, chromium_page, needs_chromium, serious_findings, serving
from playwright.sync_api import expect
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.messages import stamp_to_ns
from rgbd_dic_processing.core.carried_regions import carried_regions
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.nodes.messages import crack_opening_from_message, subset_field_from_message
from rgbd_dic_processing.results import read_truth
from system import SAMPLE

pytestmark = [needs_chromium, pytest.mark.timeout(200)]


SEEN = """() => {
  const data = (id) => document.getElementById(id).dataset, words = document.getElementById("value").textContent;
  return [data("opening").stamp, data("opening").value, words, data("uncertainty").value, data("picture").stamp,
    data("picture").outlines];
}"""


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def published(run: Path) -> dict:
    """Stamp -> opening, as the graph's own recorder heard it."""
    with BagReader(run / "bag") as bag:
        openings = [crack_opening_from_message(message) for _, _, message in bag.messages(["/crack_opening"])]
    return {opening.stamp_ns: opening for opening in openings}


def test_the_page_shows_what_is_published_and_its_buttons_act(tmp_path: Path) -> None:
    """Two seconds of flight, played at a fifth of their speed."""
    run, port = tmp_path / "run", free_port()
    with (
        serving("up", SAMPLE, "--rate", 0.2, "--page", port, "--domain", 86, "--out", run) as address,
        chromium_page(LAPTOP) as page,
    ):
        page.goto(address)
        shown, outlines = {}, {}

        def look() -> int:
            """Remember what is on the page; returns the stamp of the opening."""
            seen = page.evaluate(SEEN)
            if seen[0] and seen[1]:
                shown[int(seen[0])] = seen[1:4]
            if seen[4] and json.loads(seen[5]):
                outlines[int(seen[4])] = json.loads(seen[5])
            return int(seen[0] or 0)

        expect(page.locator("#state")).to_have_text("valid", timeout=60_000)
        expect(page.locator("#nodes")).to_contain_text("crack_opening_node")
        expect(page.locator("#nodes")).to_contain_text("player_node")
        assert serious_findings(page) == []
        first_reference = look()
        page.get_by_role("button", name="Take reference").click()
        expect(page.locator("#said")).to_contain_text("next good image becomes the reference")
        page.get_by_label("What was noticed").fill("a gust  of wind")
        page.get_by_role("button", name="Mark an event").click()
        expect(page.locator("#said")).to_have_text("marked: a gust of wind")
        page.get_by_role("button", name="Stop recording").click()
        expect(page.locator("#said")).to_contain_text("not recording")
        expect(page.get_by_role("button", name="Start recording")).to_be_visible(timeout=10_000)
        page.wait_for_timeout(500)
        page.get_by_role("button", name="Start recording").click()
        expect(page.locator("#said")).to_have_text("recording")
        for _ in range(20):
            look()
            page.wait_for_timeout(200)
    openings = published(run)
    stamps = sorted(shown)
    assert len(stamps) > 5
    heard = [stamp for stamp in stamps if stamp in openings]  # while it was told not to, the recorder wrote none
    assert len(heard) > 5
    for stamp in heard:
        value, words, uncertainty = shown[stamp]
        opening = openings[stamp]
        assert float(value) == pytest.approx(opening.opening_m * 1e3, rel=1e-12)
        assert float(words.replace("−", "-")) == round(opening.opening_m * 1e3, 3)
        assert float(uncertainty) == pytest.approx(opening.u_opening_m * 1e3, rel=1e-12)
    references = {opening.reference_stamp_ns for opening in openings.values()}
    assert len(references) == 2 and max(references) >= first_reference
    with BagReader(run / "bag") as bag:
        events = [message for _, _, message in bag.messages(["/event"])]
        fields = [subset_field_from_message(message) for _, _, message in bag.messages(["/subset_field"])]
        recorded = [stamp_to_ns(message.header.stamp) for _, _, message in bag.messages(["/camera/camera_info"])]
    assert [event.text for event in events] == ["a gust of wind"]
    assert min(openings) <= stamp_to_ns(events[0].header.stamp) <= max(openings)
    gaps = np.diff(sorted(recorded)) * 1e-9
    assert gaps.max() > 0.08 > 0.02 > np.median(gaps)  # 0.5 s and more at a fifth of the speed are not recorded
    regions, camera = load_regions(SAMPLE / "regions.yaml"), load_calibration(SAMPLE / "calibration.yaml").camera
    carried = {f.stamp_ns: carried_regions(regions, camera, f.view) for f in fields if f.stamp_ns in outlines}
    assert len(carried) > 3
    for stamp, of_field in carried.items():
        np.testing.assert_allclose(outlines[stamp]["left"], of_field["left"], atol=0.051)  # sent with one decimal


def test_regions_of_a_running_graph_are_set_from_the_page(tmp_path: Path) -> None:
    """Other zones, half as long, while the bag plays: from then on they are measured, from the image they lie on.

    The right plate opens to 1 mm; the change since the new reference is as near to the truth as with the zones before,
    0.005 mm RMS and less than 0.02 mm for each image.
    """
    run, port = tmp_path / "run", free_port()
    page_options = ("--live", "--port", port, "--domain", 87, "--out", tmp_path / "drawn.yaml")
    with (
        serving("regions", *page_options) as address,
        serving("up", SAMPLE, "--rate", 0.15, "--domain", 87, "--out", run, says="1/120"),
        chromium_page(LAPTOP) as page,
    ):
        page.goto(f"{address}regions")
        expect(page.locator("#verdict")).to_have_class("fine", timeout=60_000)
        expect(page.locator("#sizes")).to_contain_text("mm")  # from the plane of the running graph
        page.get_by_role("button", name="Measuring zones", exact=True).click()
        handle = page.get_by_role("button", name="direction of the crack and length")
        handle.focus()
        for _ in range(3):
            page.keyboard.press("Shift+ArrowUp")
        expect(page.get_by_role("button", name="Measure with these")).to_be_enabled()
        page.get_by_role("button", name="Measure with these").click()
        expect(page.locator("#said")).to_contain_text("measured by the new regions")
        page.get_by_role("button", name="Save", exact=True).click()
        expect(page.locator("#said")).to_contain_text("saved")
        page.wait_for_timeout(6000)
    drawn = yaml.safe_load((tmp_path / "drawn.yaml").read_text())
    assert drawn["crack"]["size"][1] == pytest.approx(60, abs=3)
    openings = published(run)
    references = sorted({opening.reference_stamp_ns for opening in openings.values()})
    assert len(references) == 2
    before, after = ([o for o in openings.values() if o.reference_stamp_ns == r] for r in references)
    assert all(opening.valid for opening in (*before, *after)) and len(after) > 10
    assert {opening.n_left for opening in before} == {72} and max(opening.n_left for opening in after) <= 42
    truth = read_truth(SAMPLE / "truth.csv")
    true_m = dict(zip(truth.stamps_ns.tolist(), truth.jump_m[:, 0], strict=True))
    error = [o.opening_m - (true_m[o.stamp_ns] - true_m[o.reference_stamp_ns]) for o in after]
    assert np.abs(error).max() < 2e-5


def test_a_token_lets_a_browser_in_from_elsewhere(tmp_path: Path) -> None:
    token = "a-token-of-the-test"
    options = ("--out", tmp_path / "r.yaml", "--host", "0.0.0.0", "--port", 0)
    with serving("regions", SAMPLE, *options, RGBD_DIC_TOKEN=token) as address, chromium_page() as page:
        assert address.endswith(f"?token={token}")
        here = address.replace("ADDRESS_OF_THIS_COMPUTER", "127.0.0.1")
        assert page.request.get(here.split("?")[0]).status == 401
        page.goto(here)
        expect(page.locator("#verdict")).to_have_class("fine")
        assert "token" not in page.url and token not in page.content()
