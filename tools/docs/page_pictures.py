"""Pictures of the operator's pages for docs/operator.md, from the sample bag; needs Chromium.

    tools/run python tools/docs/page_pictures.py [--folder FOLDER]

With a folder, every picture goes there, at laptop and tablet size; without, the laptop's go to docs/images.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pictures import small_copy
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "bags" / "sample"
SIZES = {"laptop": {"width": 1366, "height": 768}, "tablet": {"width": 820, "height": 1180}}
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


@contextmanager
def serving(folder: Path, *arguments: object) -> Iterator[str]:
    """`rgbd-dic` with these arguments in a folder; gives the address that it prints."""
    environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    process = subprocess.Popen(
        ["rgbd-dic", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
        cwd=folder,
    )
    try:
        yield next(found.group() for line in process.stdout if (found := re.search(r"http://\S+", line)))
    finally:
        process.terminate()
        process.wait(30)


def regions(page: Page) -> None:
    page.locator("#verdict.fine").wait_for()
    page.get_by_role("button", name="Measuring zones", exact=True).click()


def live(page: Page) -> None:
    page.locator(".state.valid").wait_for(timeout=120_000)
    page.wait_for_timeout(9000)
    page.get_by_label("What was noticed").fill("gust")
    page.get_by_role("button", name="Mark an event").click()
    page.wait_for_timeout(3000)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, help="where all pictures go (default: the laptop's, to docs/images)")
    folder = parser.parse_args().folder
    with tempfile.TemporaryDirectory() as made, sync_playwright() as playwright:
        work = Path(made)
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        pages = {
            "regions": (regions, ("regions", SAMPLE, "--out", "regions.yaml", "--port", 0)),
            "live": (live, ("up", SAMPLE, "--rate", 0.08, "--page", 8498, "--domain", 99, "--out", "run")),
        }
        for name, (prepare, arguments) in pages.items():
            with serving(work, *arguments) as address:
                page = browser.new_page(viewport=SIZES["laptop"])
                page.goto(address)
                prepare(page)
                for size, viewport in SIZES.items():
                    page.set_viewport_size(viewport)
                    page.wait_for_timeout(1000)
                    page.screenshot(path=work / f"operator_{name}_{size}.png")
                page.close()
        browser.close()
        for picture in work.glob("*.png"):
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
                picture.rename(folder / picture.name)
            elif picture.stem.endswith("laptop"):
                small_copy(picture, ROOT / "docs" / "images" / f"{picture.stem.removesuffix('_laptop')}.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
