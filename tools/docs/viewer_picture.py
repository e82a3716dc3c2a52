"""The layout in Foxglove itself, as a picture for docs/viewers.md; needs Chromium and npm.

    tools/run python tools/docs/viewer_picture.py BAG          # an annotated bag, or one of up --viewers
    tools/run python tools/docs/viewer_picture.py ws://127.0.0.1:8765

npm brings @foxglove/studio-base 1.48.0, the last of Foxglove's releases that it has (MPL-2.0, 2023): the whole
application, but for the page around it. Three things differ from the layout and the server as they are today, and are
bent here: the Image panel had another name and another form of settings, plots could not multiply (`.@mul`), and the
websocket's protocol was called foxglove.websocket.v1.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from aiohttp import web
from pictures import small_copy
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[2]
LAYOUT = ROOT / "src/rgbd_dic_processing/viewers/rgbd_dic.foxglove.json"
PACKAGES = ("react@17.0.2", "react-dom@17.0.2", "@foxglove/studio-base@1.48.0")
PORT = 8799
FLAGS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-background-networking", "--disable-component-update"),
)
SIZE, SIDEBAR_PX = {"width": 1622, "height": 950}, 422
PAGE = """<!doctype html><meta charset="utf-8"><style>html, body, #root {height: 100%; margin: 0}</style>
<div id="root"></div>
<script src="react/umd/react.production.min.js"></script><script>window.react = React</script>
<script src="react-dom/umd/react-dom.production.min.js"></script><script>window["react-dom"] = ReactDOM</script>
<script src="@foxglove/studio-base/assets/index.js"></script>
<script type="module">
localStorage.setItem("studio.profile-data", JSON.stringify({currentLayoutId: "rgbd_dic"}));
const data = await (await fetch("layout.json")).json();
const settings = {colorScheme: "dark", "ui.open-dialog-startup": false, hideSignInPrompt: true};
const appConfiguration = {get: (key) => settings[key], set: async () => {}, addChangeListener() {},
  removeChangeListener() {}};
const layout = {id: "rgbd_dic", name: "rgbd_dic", permission: "CREATOR_WRITE", baseline: {data}};
const layoutStorage = {list: async () => [layout], get: async () => layout, put: async (_, given) => given,
  delete: async () => {}, importLayouts: async () => {}};
await initI18n();
const dataSources = [new FoxgloveWebSocketDataSourceFactory(), new RemoteDataSourceFactory()];
const deepLinks = ["http://localhost/" + location.search];
ReactDOM.render(React.createElement(App, {deepLinks, appConfiguration, dataSources, layoutStorage,
  extensionLoaders: [], enableGlobalCss: true}), document.getElementById("root"));
</script>"""


def bent(layout: dict[str, Any]) -> dict[str, Any]:
    """The layout for that old application."""
    text = json.dumps(layout).replace("Image!", "ImageViewPanel!")
    layout = json.loads(text.replace("[:].@mul(1000)", "[:]").replace("Displacement [mm]", "Displacement [m]"))
    for panel in layout["configById"].values():
        if mode := panel.pop("imageMode", None):
            panel["cameraTopic"], panel["synchronize"] = mode["imageTopic"], mode.get("synchronize", False)
            panel["enabledMarkerTopics"] = list(mode.get("annotations", ()))
    return layout


async def serve(modules: Path, bag: Path | None) -> None:
    async def script(request: web.Request) -> web.StreamResponse:
        text = (modules / request.path.lstrip("/")).read_text()
        return web.Response(
            text=text.replace("foxglove.websocket.v1", "foxglove.sdk.v1"), content_type="text/javascript"
        )

    async def recording(_: web.Request) -> web.StreamResponse:
        return web.FileResponse(bag)

    async def page(_: web.Request) -> web.StreamResponse:
        return web.Response(text=PAGE, content_type="text/html")

    async def layout(_: web.Request) -> web.StreamResponse:
        return web.json_response(bent(json.loads(LAYOUT.read_text())))

    app = web.Application()
    app.router.add_get("/", page)
    app.router.add_get("/layout.json", layout)
    app.router.add_get("/bag.mcap", recording)
    app.router.add_get("/@foxglove/studio-base/assets/{name:.*\\.js}", script)
    app.router.add_static("/", modules)
    runner = web.AppRunner(app, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", PORT).start()
    await asyncio.Event().wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", help="bag, or address of a websocket")
    parser.add_argument("--time", default="2025-06-15T15:06:41.6Z", help="moment of the bag (default: of the sample's)")
    parser.add_argument("--wait", type=float, default=40.0, help="until all has been drawn [s]")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/images/viewers_foxglove.png")
    options = parser.parse_args()
    live = options.source.startswith("ws")
    bag = None if live else next(iter(Path(options.source).glob("*.mcap")), Path(options.source))
    query = {"layoutId": "rgbd_dic", "ds": "foxglove-websocket" if live else "remote-file"}
    query |= {"ds.url": options.source if live else f"http://127.0.0.1:{PORT}/bag.mcap"}
    query |= {} if live else {"time": options.time}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        subprocess.run(["npm", "install", "--no-audit", "--no-fund", "--silent", *PACKAGES], cwd=folder, check=True)
        modules = Path(folder, "node_modules")
        threading.Thread(target=lambda: asyncio.run(serve(modules, bag)), daemon=True).start()
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=list(FLAGS))
        page = browser.new_page(viewport=SIZE)
        page.on("pageerror", lambda error: print(f"the application says: {error}"))
        page.goto(f"http://127.0.0.1:{PORT}/?{urlencode(query)}", timeout=120_000, wait_until="commit")
        page.wait_for_timeout(1000 * options.wait)
        if (hint := page.get_by_text("Open settings to configure")).count():
            hint.locator("xpath=..").get_by_role("button").click()
        picture = Path(folder, "picture.png")
        clip = {"x": SIDEBAR_PX, "y": 0, "width": SIZE["width"] - SIDEBAR_PX, "height": SIZE["height"] - 78}
        page.screenshot(path=picture, clip=clip, timeout=180_000)
        browser.close()
        small_copy(picture, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
