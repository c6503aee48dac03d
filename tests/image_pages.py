"""A small server with the addresses of images, and a page that has their panels alone, without the whole studio."""

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

import mgsgraph
from mgsgraph.errors import MgsgraphError
from mgsgraph.geometry.records import Array
from mgsgraph.studio.changes import EditLock
from mgsgraph.studio.opened import Block
from mgsgraph.studio.routes import Views, routes

PAGE = Path(mgsgraph.__file__).parent / "studio" / "page"
_HTML = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>images</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<link rel="stylesheet" href="/page/views.css"></head>
<body><main id="panel"></main><script type="module" src="/app.js"></script></body></html>"""
_APP = """
class App extends EventTarget {
  said = []; changes = []; selection = null;
  async request(path, body) {
    const answer = await fetch(path, body ? {method: 'POST', body: JSON.stringify(body)} : {});
    const found = await answer.json();
    if (!answer.ok) throw new Error(found.error);
    return found;
  }
  say(words) { this.said.push(words); }
  place(at) { this.placed = at; }
  select(name) { this.selection = name; this.dispatchEvent(new Event('selected')); }
  async change(body) { this.changes.push(body); this.dispatchEvent(new CustomEvent('changed', {detail: {}}));
    this.dispatchEvent(new Event('renewed')); return {}; }
}
const app = window.app = new App();
app.scene = await app.request('/api/scene');
const {panel} = await import(`/page/${location.hash.slice(1)}.js`);
window.view = panel(app, document.getElementById('panel'));
"""


class Scene:
    """What the addresses of images know of a block.

    Parameters
    ----------
    block : Block
    pictures : dict
        File of each image's pixels.
    """

    def __init__(self, block: Block, pictures: dict[str, Path | None]) -> None:
        self.pictures, self.revision, self._block = pictures, 0, block

    def block(self) -> Block:
        return self._block

    def map_places(self, points: Array) -> Array:
        return points[:, :2]


def application(scene: Scene) -> Starlette:
    def described(_: Request) -> Response:
        images = [{"name": one.name, "lines": one.lines, "samples": one.samples} for one in scene.block().images]
        return JSONResponse({"images": images, "revision": scene.revision, "writable": True})

    async def refine(request: Request) -> Response:
        asked = await request.json()
        if asked["line"] > 4000.0:
            return JSONResponse({"error": "too little texture."}, 400)
        found = {"line": asked["line"] + 0.25, "sample": asked["sample"] - 0.25, "sigma_px": 0.07, "correlation": 0.93}
        return JSONResponse(found)

    async def failed(_: Request, error: Exception) -> Response:
        return JSONResponse({"error": str(error)}, 400)

    return Starlette(
        routes=[
            Route("/", lambda _: HTMLResponse(_HTML)),
            Route("/app.js", lambda _: Response(_APP, media_type="text/javascript")),
            Route("/api/scene", described), Route("/api/refine", refine, methods=["POST"]),
            *routes(scene, Views(scene), EditLock()),
            Mount("/page", StaticFiles(directory=PAGE)),
        ],
        exception_handlers={MgsgraphError: failed},
    )  # fmt: skip


@contextmanager
def served(scene: Scene) -> Iterator[str]:
    """The address of a server that runs until the end of the block."""
    server = uvicorn.Server(uvicorn.Config(application(scene), port=0, log_level="error", ws="none"))
    running = threading.Thread(target=server.run)
    running.start()
    while not server.started:
        running.join(0.02)
        assert running.is_alive()
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        running.join()


def textured(path: Path, lines: int, samples: int, seed: int) -> Path:
    """A GeoTIFF of noise of many wavelengths."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    random, pixels = np.random.default_rng(seed), np.zeros((lines, samples), dtype=np.float32)
    for step in (1, 8, 64):
        coarse = random.normal(128.0, 20.0, (-(-lines // step), -(-samples // step)))
        pixels += np.kron(coarse, np.ones((step, step)))[:lines, :samples] / 3.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        size: dict[str, Any] = {"height": lines, "width": samples, "count": 1, "dtype": "uint8"}
        with rasterio.open(path, "w", driver="GTiff", **size) as file:
            file.write(np.clip(pixels, 0, 255).astype(np.uint8), 1)
    return path


class Seen:
    """A page, what it complained of and what it asked for."""

    def __init__(self, browser: Any, address: str, panel: str = "images", width: int = 1280, **settings: Any) -> None:
        self.complaints: list[str] = []
        self.page = browser.new_page(viewport={"width": width, "height": 900}, **settings)
        self.page.on("console", lambda one: self.complaints.append(one.text))
        self.page.on("pageerror", lambda one: self.complaints.append(str(one)))
        self.asked: list[str] = []
        self.page.on("request", lambda one: self.asked.append(one.url))
        self.page.goto(f"{address}/#{panel}")
        self.page.wait_for_function("window.view")
        if panel == "images":
            self.page.wait_for_function("view.panes.length === 2 && view.panes[1].image && view.link")
            self.page.wait_for_function("view.mapping(view.panes[1])")
            self.page.wait_for_function("view.panes.every(one => !one.layer || one.layer.complete)")

    def run(self, script: str, what: Any = None) -> Any:
        return self.page.evaluate(script, what)

    def at(self, pane: int, x: float, y: float) -> None:
        """Move the pointer to a share of a pane's width and height, and wait for the answer."""
        box = self.page.locator(".image-canvas").nth(pane).bounding_box()
        self.page.mouse.move(box["x"] + x * box["width"], box["y"] + y * box["height"])
        self.settled()

    def settled(self) -> None:
        self.page.wait_for_timeout(50)
        self.page.wait_for_function("!view.asked.running && !view.waiting")

    def close(self) -> None:
        assert not self.complaints
        self.page.close()
