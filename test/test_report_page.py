"""The report of a run in a real browser: whole, self-contained, accessible, and printed on pages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from browser import chromium_page, needs_chromium, serious_findings
from system import rgbd_dic

HEADINGS = ("Opening", "Validity", "Displacement maps", "Error budget", "Images", "ToF frames", "Calibration")
pytestmark = [needs_chromium, pytest.mark.timeout(280)]


@pytest.fixture(scope="module")
def report(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "run"
    done = rgbd_dic("process", flight, "--method", "h_pose,h_2d", "--maps-at", "0.2", "--out", out)
    assert done.returncode == 0, done.stderr
    assert rgbd_dic("report", out).returncode == 0
    return out / "report.html"


def test_page_stands_alone_and_has_no_serious_finding(report: Path) -> None:
    with chromium_page() as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url[:40]))
        page.goto(report.as_uri())
        assert all(url.startswith(("file:", "data:")) for url in asked)
        assert page.locator("img").evaluate_all("images => images.every(image => image.naturalWidth > 0)")
        for heading in (
            "Opening",
            "Validity",
            "Displacement maps",
            "Error budget",
            "Images",
            "ToF frames",
            "Calibration",
        ):
            assert page.get_by_role("heading", name=heading, exact=True).count() == 1
        assert page.get_by_text("the frame nearest to 0.2 s").count()
        assert not serious_findings(page)
        wider = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wider == 0


def test_printed_figures_are_whole(report: Path) -> None:
    """On paper no figure is taller than what fits on a page with its caption, and none lies across two pages."""
    with chromium_page() as page:
        page.goto(report.as_uri())
        pages = len(re.findall(rb"/Type\s*/Page[^s]", page.pdf(prefer_css_page_size=True)))
        assert 6 <= pages <= 20
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 680, "height": 960})  # A4 without its margins, at 96 px an inch
        tallest = page.locator("figure").evaluate_all("all => Math.max(...all.map(one => one.offsetHeight))")
        assert tallest < 1000
