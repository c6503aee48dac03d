"""A tab of a real browser at a studio, for the tests of its page; and how smoothly a panel of it moves."""

from collections.abc import Callable
from typing import Any

from studio_server import Studio

PANELS = ("map", "images", "point", "questions")


class Page:
    """A tab of the browser at a studio, what it complained of and what it asked for."""

    def __init__(self, browser: Any, running: Studio, width: int = 1280, **settings: Any) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": 900}, accept_downloads=True, **settings)
        self.tab = self.context.new_page()
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.tab.on("console", lambda one: self.complaints.append(one.text) if one.type == "error" else None)
        self.tab.on("pageerror", lambda one: self.complaints.append(str(one)))
        self.tab.on("request", lambda one: self.asked.append(one.url))
        self.root = running.root
        self.tab.goto(running.address)
        self.tab.wait_for_selector("#map[data-ready]")

    def run(self, script: str, *arguments: Any) -> Any:
        return self.tab.evaluate(script, *arguments)

    def until(self, script: str, argument: Any = None) -> None:
        """Wait until a script is true; Playwright's own waiting evaluates texts in the page, which that forbids."""
        for _ in range(150):
            if self.run(script, argument):
                return
            self.tab.wait_for_timeout(100)
        raise AssertionError(script)

    def show(self, key: str) -> None:
        """A panel by its key."""
        self.run("document.activeElement.blur()")
        self.tab.keyboard.press(key)
        self.tab.wait_for_selector(f"#{PANELS[int(key) - 1]}:not([hidden])")

    def close(self) -> None:
        assert self.complaints == []
        assert {one for one in self.asked if not one.startswith((self.root, "data:", "blob:"))} == set()
        self.context.close()


_RATE = """async () => {
  const view = VIEW;
  const rate = async act => {
    const begin = performance.now(), before = view.statistics.COUNTED;
    let k = 0;
    await new Promise(done => { const step = () => {
      act(k++);
      performance.now() - begin < 1500 ? requestAnimationFrame(step) : done();
    }; requestAnimationFrame(step); });
    return 1000 * (view.statistics.COUNTED - before) / (performance.now() - begin);
  };
  return [await rate(k => PAN), await rate(k => ZOOM)];
}"""
_TRIES = 8
_ENOUGH = 30.0


def rates(run: Callable[[str], Any], view: str, counted: str, pan: str, zoom: str) -> list[float]:
    """Frames a second of panning and of zooming, each act moving a frame and asking for the next: the best of some
    tries of 1.5 s each, for what else runs on the machine only takes away from them.
    """
    script = _RATE.replace("VIEW", view).replace("COUNTED", counted).replace("PAN", pan).replace("ZOOM", zoom)
    best = [0.0, 0.0]
    for _ in range(_TRIES):
        best = [max(both) for both in zip(best, run(script), strict=True)]
        if min(best) >= _ENOUGH:
            break
    print(f"frames per second: pan {best[0]:.0f}, zoom {best[1]:.0f}")
    return best
