"""The studio's command, started for a test, and asked as a browser would, or by one."""

import json
import re
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.cookiejar import CookieJar
from pathlib import Path
from typing import Any

_ADDRESS = re.compile(r"(http://127\.0\.0\.1:\d+)(/\?token=\S+)")


@dataclass
class Studio:
    """A running studio."""

    process: "subprocess.Popen[str]"
    root: str = ""
    """http://127.0.0.1:PORT."""
    printed: str = ""
    """Path of an address that was read and not used."""

    def read(self) -> None:
        """Read the next address that the command prints."""
        assert self.process.stdout is not None
        while (found := _ADDRESS.search(line := self.process.stdout.readline())) is None:
            assert line, self.process.communicate()[1]
        self.root, self.printed = found[1], found[2]

    def entrance(self) -> str:
        """Path of the address that was printed last; it works once."""
        if not self.printed:
            self.read()
        path, self.printed = self.printed, ""
        return path

    def browser(self, name: str = "") -> "Browser":
        """One that has been at the address."""
        found = Browser(self.root, name)
        _, _, page = found.ask(self.entrance())
        found.secret = page.decode().rpartition('data-secret="')[2].partition('"')[0]
        assert found.secret
        return found


class Browser:
    """Asks with its cookies and its secret."""

    def __init__(self, root: str, name: str = "") -> None:
        self.root, self.name, self.secret, self.cookies = root, name, "", CookieJar()
        self._opener = urllib.request.build_opener(
            urllib.request.ProxyHandler({}), urllib.request.HTTPCookieProcessor(self.cookies)
        )

    def ask(
        self, path: str, body: Any = None, headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of an answer; headers that are empty are not sent."""
        sent = {"X-Browser": self.name, "X-Secret": self.secret}
        data = None
        if body is not None:
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
            sent |= {"Content-Type": "application/json", "Origin": self.root}
        sent = {name: value for name, value in (sent | (headers or {})).items() if value}
        request = urllib.request.Request(self.root + path, data, sent)
        try:
            with self._opener.open(request, timeout=60) as answer:
                return answer.status, dict(answer.headers), answer.read()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, dict(error.headers), error.read()

    def json(self, path: str, body: Any = None) -> Any:
        """The object of a good answer."""
        status, _, data = self.ask(path, body)
        found = json.loads(data)
        assert status == 200, data
        assert not (isinstance(found, dict) and "error" in found), found
        return found

    def refused(self, path: str, body: Any = None) -> str:
        """The sentence of a refusal."""
        status, _, data = self.ask(path, body)
        assert status == (200 if self.name else 400), (status, data[:300])
        sentence = json.loads(data)["error"]
        assert len(sentence.splitlines()) == 1
        return str(sentence)


@contextmanager
def studio(path: Path, *more: str, no_browser: bool = True) -> Iterator[Studio]:
    """Run `mgsgraph studio PATH`."""
    words = [sys.executable, "-W", "error", "-m", "mgsgraph", "studio", str(path), *more]
    words += ["--no-browser"] if no_browser else []
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            found = Studio(process)
            found.read()
            yield found
        finally:
            process.kill()


# --- in a real browser

PANELS = ("start", "map", "images", "lists", "point", "questions")
"""In the order of their keys."""


class Page:
    """A tab of the browser at a studio, what it complained of and what it asked for."""

    longest, between = 60.0, 0.1
    """s, for which it waits, and between two looks."""

    def __init__(self, browser: Any, running: Studio, width: int = 1280, **settings: Any) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": 900}, accept_downloads=True, **settings)
        self.tab = self.context.new_page()
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.tab.on("console", lambda one: self.complaints.append(one.text) if one.type == "error" else None)
        self.tab.on("pageerror", lambda one: self.complaints.append(str(one)))
        self.tab.on("request", lambda one: self.asked.append(one.url))
        self.root = running.root
        self.tab.goto(running.root + running.entrance())
        self.until("Boolean(studio.scene && document.getElementById('start').view)")
        self.show("map")
        self.tab.wait_for_selector("#map[data-ready][data-outlines]")
        self.until("!document.getElementById('map').view.asking")

    def run(self, script: str, *arguments: Any) -> Any:
        return self.tab.evaluate(script, *arguments)

    def until(self, script: str, argument: Any = None) -> None:
        """Wait until a script is true; Playwright's own waiting evaluates texts in the page, which that forbids."""
        for _ in range(int(self.longest / self.between)):
            if self.run(script, argument):
                return
            self.tab.wait_for_timeout(1e3 * self.between)
        raise AssertionError(script)

    def show(self, panel: str) -> None:
        """A panel, by its key."""
        self.run("document.activeElement.blur()")
        self.tab.keyboard.press(str(PANELS.index(panel) + 1))
        self.tab.wait_for_selector(f"#{panel}:not([hidden])")
        self.until("id => Boolean(document.getElementById(id).view)", panel)

    def close(self) -> None:
        complaints = [one for one in self.complaints if "status of 503" not in one]  # the page asks a busy server again
        assert not complaints, complaints
        assert {one for one in self.asked if not one.startswith((self.root, "data:", "blob:"))} == set()
        self.context.close()


CONTRAST = """() => {
  const parse = text => { const one = text.match(/[\\d.]+/g).map(Number); return one.length > 3 ? one : [...one, 1]; };
  const linear = one => one <= 0.03928 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4;
  const light = rgb => [0.2126, 0.7152, 0.0722].reduce((sum, share, k) => sum + share * linear(rgb[k] / 255), 0);
  const behind = element => {
    for (let one = element; one; one = one.parentElement) {
      const found = parse(getComputedStyle(one).backgroundColor);
      if (found[3] > 0.5) return found;
    }
    return [255, 255, 255];
  };
  const own = one => [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
  const bad = [];
  for (const one of document.querySelectorAll('body *')) {
    if (!one.checkVisibility() || one.disabled || !own(one)) continue;
    const [a, b] = [light(parse(getComputedStyle(one).color)), light(behind(one))];
    if ((Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5) bad.push(one.outerHTML.slice(0, 80));
  }
  return bad; }"""
"""Texts of a page that stand out from what is behind them by less than 4.5 (WCAG 2, 1.4.3)."""
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
