"""A real browser for tests of the pages: Debian's Chromium, driven by Playwright, which downloads none of its own."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from system import environment

CHROMIUM = shutil.which("chromium") or "/usr/bin/chromium"
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
LAPTOP, TABLET = {"width": 1366, "height": 768}, {"width": 820, "height": 1180}
needs_chromium = pytest.mark.skipif(
    not Path(CHROMIUM).exists(), reason="no Chromium: apt-get install -y --no-install-recommends chromium"
)


@contextmanager
def chromium_page(viewport: dict[str, int] = LAPTOP, fingers: bool = False) -> Iterator:
    """A page whose errors, but for refused requests and lost connections, fail the test at the end."""
    from playwright.sync_api import sync_playwright

    wrong: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            page = browser.new_page(viewport=viewport, has_touch=fingers)
            page.set_default_timeout(20_000)
            page.on("pageerror", lambda error: wrong.append(str(error)))
            page.on("console", lambda said: wrong.append(said.text) if is_wrong(said) else None)
            yield page
        finally:
            browser.close()
    assert not wrong


def is_wrong(said) -> bool:
    """Whether what a page writes into the console is a fault of its own."""
    return said.type == "error" and not said.text.startswith(("Failed to load resource", "WebSocket connection"))


def serious_findings(page) -> list[str]:
    """What axe-core finds wrong with the accessibility of a page, of serious or critical impact."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [
        f"{entry['id']}: {entry['help']}: {entry['nodes'][0]['html']}"
        for entry in found
        if entry["impact"] in ("serious", "critical")
    ]


@contextmanager
def serving(*arguments: str | Path, says: str = r"http://\S+", **variables: str) -> Iterator[str]:
    """`rgbd-dic` with these arguments, until it is ended; gives what it says first that matches."""
    command = ["rgbd-dic", *map(str, arguments)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**environment(), **variables}
    )
    said: list[str] = []
    try:
        for line in process.stdout:
            said.append(line)
            if heard := re.search(says, line):
                break
        else:
            raise AssertionError(f"{' '.join(command)} ended: {''.join(said)}")
        threading.Thread(target=process.stdout.read, daemon=True).start()  # so that it is never held up
        yield heard.group()
    finally:
        process.terminate()
        process.wait(20)
