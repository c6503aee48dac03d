"""Who may ask a studio: other accounts, other ports; what is too long, too large, too much or too slow."""

import asyncio
import http.server
import json
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from commands import call

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
import h11
import uvicorn
from starlette.exceptions import HTTPException
from studio_server import Browser, Page, Studio, studio

from mgsgraph.errors import InputError
from mgsgraph.names import Names
from mgsgraph.network.parts import KnownImage
from mgsgraph.project.addition import Addition, NewImage
from mgsgraph.project.changes import store_unadjusted
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings
from mgsgraph.studio import routes, server
from mgsgraph.studio.inputs import bounded

NOBODY = 65534
ANSWERS = (
    "/api/state", "/api/scene", "/api/map/outlines", "/api/map/points?x0=0&y0=0&x1=1&y1=1", "/api/map/images",
    "/api/map/tile.png?level=4&row=0&column=0",
    "/api/map/graticule?x0=0&y0=0&x1=1&y1=1", "/api/map/distance?x0=0&y0=0&x1=1&y1=1",
    "/api/map/sigmas", "/api/map/residuals", "/api/map/where?x=0&y=0", "/api/map/figure?kind=svg", "/api/select",
    "/api/image?name=A", "/api/image/tile.png?name=A", "/api/image/ground?name=A",
    "/api/image/contrast?name=A", "/api/point?name=A", "/api/point/tests?name=A",
    "/api/point/correlations?name=A", "/api/chip.png?image=A", "/api/plan",
    "/api/changes", "/api/refine", "/api/questions",
)  # fmt: skip


@pytest.fixture(scope="module")
def running(solved: Path) -> Iterator[Studio]:
    with studio(solved) as found:
        yield found
        found.process.kill()
        assert found.process.stderr is not None
        assert found.process.stderr.read() == ""  # no traceback


@pytest.fixture(scope="module")
def known(running: Studio) -> Browser:
    return running.browser()


# --- the address, the cookie and the secret


def test_an_address_works_once_and_then_another_one_is_printed(running: Studio, known: Browser) -> None:
    path = running.entrance()
    first, second = Browser(running.root), Browser(running.root)
    assert first.ask(path)[0] == 200
    assert second.ask(path)[0] == 403
    assert first.ask(path)[0] == 200  # opened again: the page
    assert second.ask("/")[0] == 403
    assert running.browser().json("/api/scene") == known.json("/api/scene")


def test_cookie_and_secret_are_both_needed(running: Studio, known: Browser) -> None:
    assert known.ask("/api/scene")[0] == 200
    (cookie,) = known.cookies
    assert cookie.name == f"mgsgraph_studio_{running.root.rpartition(':')[2]}"
    assert cookie.has_nonstandard_attr("HttpOnly")
    assert cookie.get_nonstandard_attr("SameSite") == "strict"
    for path in ANSWERS:
        body = {"kind": "undo"} if path in ANSWERS[-3:] else None
        for headers in ({"X-Secret": ""}, {"X-Secret": cookie.value or ""}):
            assert known.ask(path, body, headers)[0] == 403, path
        other = Browser(running.root)
        other.secret = known.secret
        assert other.ask(path, body)[0] == 403, path


def test_a_studio_at_another_port_knows_neither(running: Studio, known: Browser, solved: Path) -> None:
    with studio(solved) as other:
        assert known.ask("/api/scene")[0] == 200
        stranger = Browser(other.root)
        for cookie in known.cookies:  # as a browser sends it to all ports
            stranger.cookies.set_cookie(cookie)
        stranger.secret = known.secret
        assert [stranger.ask(path)[0] for path in ("/", "/api/scene")] == [403, 403]


def test_reload_and_second_tab_work_and_another_port_gets_the_cookie_alone(
    browser: Any, running: Studio, tmp_path: Path
) -> None:
    """The browser enters by the file that leads to the address, as the command opens it."""
    received: list[str] = []

    class Other(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            received.append(self.headers.get("Cookie", ""))
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>other</title>")

        def log_message(self, *_: Any) -> None: ...

    page = tmp_path / "studio.html"
    page.write_text(server.FORWARD.format(running.root + running.entrance()), encoding="utf-8")
    context = browser.new_context()
    tab = context.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_selector("#start .worst")
    assert tab.url == f"{running.root}/"
    tab.reload()
    tab.wait_for_selector("#start .worst")
    second = context.new_page()
    second.goto(running.root)
    second.wait_for_selector("#start .worst")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Other) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        third = context.new_page()
        third.goto(f"http://127.0.0.1:{other.server_port}/")
        assert "mgsgraph_studio_" in received[0]
        assert third.evaluate("localStorage.length") == 0
        asked = "path => fetch(path, {credentials: 'include'}).then(one => one.text(), () => '')"
        assert [third.evaluate(asked, running.root + path) for path in ("/", *ANSWERS)] == [""] * (1 + len(ANSWERS))
        other.shutdown()
    for path in ANSWERS[:-3]:
        request = urllib.request.Request(running.root + path, headers={"Cookie": received[0]})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(request, timeout=20)
    context.close()


# --- other accounts


def _listening_ports(process: int) -> list[int]:
    """Ports at which a process listens, by the kernel."""
    links = map(os.path.realpath, Path(f"/proc/{process}/fd").iterdir())  # those closed meanwhile lead nowhere
    sockets = {link.partition("socket:[")[2][:-1] for link in links if "socket:[" in link}
    rows = [row.split() for table in ("tcp", "tcp6") for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
    return [int(row[1].rpartition(":")[2], 16) for row in rows if row[3] == "0A" and row[9] in sockets]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may become another user")
def test_another_account_gets_nothing(solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It reads all command lines, tries the file, and asks every port, with the cookie that another port has got."""
    opened = tmp_path / "opened"
    shown = tmp_path / "browser"
    shown.write_text(f'#!/bin/sh\necho "$1" > {opened}\nexec {sys.executable} -c "import time; time.sleep(60)" "$1"\n')
    shown.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{shown} %s &")
    with studio(solved, no_browser=False) as running:
        while not (opened.exists() and opened.read_text(encoding="utf-8").strip()):
            time.sleep(0.1)
        page = Path(opened.read_text(encoding="utf-8").strip().removeprefix("file://"))
        assert running.printed in page.read_text(encoding="utf-8")
        assert (page.stat().st_mode & 0o777, page.parent.stat().st_mode & 0o777) == (0o600, 0o700)

        def attack(cookie: str = "") -> tuple[str, list[tuple[str, int, str]]]:
            ports = _listening_ports(running.process.pid)
            assert len(ports) == 1
            given = {"ports": ports, "files": [str(page), str(page.parent)], "cookie": cookie,
                     "paths": ["/", "/page/main.js", "/page/index.html", "/?token=", *ANSWERS]}  # fmt: skip
            script = Path(__file__).with_name("other_account.py").read_text(encoding="utf-8")
            words = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", sys.executable, "-I", "-S"]
            words += ["-c", script]
            ran = subprocess.run(words, input=json.dumps(given), capture_output=True, text=True, cwd="/")
            assert ran.returncode == 0, ran.stderr
            found = json.loads(ran.stdout)
            assert found["read"] == []
            return "\n".join(found["seen"]), found["answers"]

        seen, answers = attack()
        assert str(page) in seen  # the browser's command line
        assert running.printed not in seen
        assert len(answers) > 100
        assert {status for _, status, _ in answers} == {403, 421}
        token = running.printed
        known = running.browser()
        assert not page.exists()
        (cookie,) = known.cookies
        seen, answers = attack(f"{cookie.name}={cookie.value}")
        assert {status for _, status, _ in answers} == {403, 421}
        for secret in (known.secret, cookie.value or "", token.partition("=")[2]):
            assert secret not in seen
            assert not any(secret in text for _, _, text in answers)
        assert known.json("/api/scene")["name"] not in {text for _, _, text in answers}
        folder = page.parent
        running.process.terminate()
        running.process.wait(20)
    assert not folder.exists()


# --- too long, too large, too many, too slow

LONG = "Q" * 5000
ODD = [LONG, "1e300", "nan", "-inf", "9" * 5000, "", "\x00", "\ud800", "a/../b", "1e-300"]


def test_the_origin_of_a_page_is_a_text(known: Browser) -> None:
    for origin in ("http://[", "null", LONG, "http://127.0.0.1:x"):
        assert known.ask("/api/changes", {"kind": "undo"}, {"Origin": origin})[0] == 403
        assert known.ask("/api/state", headers={"Origin": origin})[0] == 200


@pytest.mark.slow
def test_odd_texts_and_numbers_are_answered_or_refused(known: Browser) -> None:
    """Every key of every address in turn; the fixture sees to it that no traceback is written."""
    scene = known.json("/api/scene")
    x0, y0, x1, y1 = scene["map"]["bounds_m"]
    point = known.json("/api/select")["names"][0]
    image = scene["images"][0]["name"]
    window = {"x0": x0, "y0": y0, "x1": x1, "y1": y1, "w": 800, "h": 600, "value": "sigma", "classes": "tie"}
    place = {"line": 5, "sample": 5}
    given: dict[str, dict[str, object]] = {
        "/api/map/points": window, "/api/map/graticule": window, "/api/map/residuals": {"image": image},
        "/api/map/tile.png": {"level": 4, "row": 0, "column": 0, "layers": "images,relief", "top": image},
        "/api/map/distance": {"from": point, "to": "", "x0": 0, "y0": 0, "x1": 9, "y1": 9},
        "/api/map/figure": {**window, "kind": "svg", "layers": "points,ellipses", "factor": 1},
        "/api/map/where": {"x": 1, "y": 1}, "/api/select": {**window, "least": 0},
        "/api/image": {"name": image}, "/api/image/ground": {"name": image, **place, "with": image},
        "/api/image/contrast": {"name": image, "line0": 1, "sample0": 1, "line1": 9, "sample1": 9},
        "/api/image/tile.png": {"name": image, "level": 0, "row": 0, "column": 0, "low": 0, "high": 1},
        "/api/point": {"name": point}, "/api/point/tests": {"name": point}, "/api/point/correlations": {"name": point},
        "/api/chip.png": {"image": image, **place}, "/page/../server.py": {}, "/page/%00": {}, f"/page/{LONG}": {},
        "/nothing": {},
    }  # fmt: skip
    for path, query in given.items():
        for key in ["", *query]:
            for odd in ODD:
                asked = query | ({key: odd} if key else {})
                words = "&".join(f"{k}={quote(str(v).encode(errors='surrogatepass'))}" for k, v in asked.items())
                status, _, data = known.ask(f"{path}?{words}")
                assert status in (200, 400, 404), (path, words, data[:300])
                if status == 400:
                    assert len(json.loads(data)["error"].splitlines()) == 1
                if not key:
                    break
    bodies: dict[str, list[dict[str, Any]]] = {
        "/api/questions": [
            {"points": [point]}, {"pairs": [[point, point]]}, {"poses": [[image, 5]]},
            {"projections": [[point, image]]},
            {"pixels": [{"image": image, **place, "sigma_px": 1}], "correlations": True},
        ],
        "/api/refine": [{"reference": {"image": image, **place}, "image": image, **place}],
    }  # fmt: skip
    odd_values = [*ODD, 1e300, -1e13, 1e12, 1e-300, 10**400, None, True, [], {}, [[]], [point] * 9000]
    for path, some in bodies.items():
        for body in some:
            for changed in _changed(body, odd_values):
                status, _, data = known.ask(path, json.dumps(changed).encode())
                assert status in (200, 400), (path, str(changed)[:200], data[:300])


def _changed(value: Any, others: list[Any]) -> Iterator[Any]:
    """A value with each of its parts, in turn, in place of which others stand."""
    yield from others
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        for part in _changed(value[key], others):
            changed = value.copy()
            changed[key] = part
            yield changed


def test_many_points_are_refused_at_once(known: Browser) -> None:
    names = known.json("/api/select")["names"]
    asked = {"points": (names * 9000)[:9000], "correlations": True}
    assert "at most 200" in known.refused("/api/questions", asked)
    answers = known.json("/api/questions", asked | {"points": asked["points"][:200]})
    assert len(answers) == 201


@pytest.mark.parametrize(
    "value", [float("nan"), 2e12, "x" * 501, "a\nb", ["a"] * 201, {"a": ["\ud800"]}, {"x" * 501: 1}]
)
def test_what_is_out_of_bounds_is_refused(value: Any) -> None:
    with pytest.raises(InputError):
        bounded(value, "request")
    assert bounded({"a": [1.5, "x", None, True]}, "request") == {"a": [1.5, "x", None, True]}


def test_a_question_beyond_the_queue_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routes, "_AT_ONCE", 2)
    monkeypatch.setattr(routes, "_MOST_WAITING", 5)
    free, most, now = threading.Event(), [0], [0]

    def answer(number: int) -> int:
        now[0] += 1
        most[0] = max(most[0], now[0])
        free.wait(20)
        now[0] -= 1
        return number

    async def ask() -> list[Any]:
        queued = routes.in_turn(answer)
        tasks = [asyncio.create_task(queued(k)) for k in range(6)]
        with pytest.raises(HTTPException) as refused:
            await tasks[5]
        assert refused.value.status_code == 503
        assert len(refused.value.detail.splitlines()) == 1
        while now[0] < 2:
            await asyncio.sleep(0.01)
        free.set()
        return [*await asyncio.gather(*tasks[:5]), await queued(7)]

    with ThreadPoolExecutor(1) as thread:  # this one has the browser's loop
        answers = thread.submit(lambda: asyncio.run(ask())).result()
    assert answers == [0, 1, 2, 3, 4, 7]
    assert most == [2]


@pytest.mark.parametrize("sent", [b"", b"GET / HTT", b"GET / HTTP/1.1\r\nHost: x\r\n",
                                  b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 99\r\n\r\nhalf",
                                  b"GET / HTTP/1.1\r\nHost: x\r\n\r\nGET / HT"])  # fmt: skip
def test_what_is_sent_by_halves_is_closed(sent: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    assert server._SECONDS == {h11.IDLE: 10.0, h11.SEND_BODY: 30.0}
    monkeypatch.setattr(server, "_SECONDS", {h11.IDLE: 0.3, h11.SEND_BODY: 0.6})

    async def application(_: Any, receive: Any, send: Any) -> None:
        while (await receive()).get("more_body"):
            pass
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    serving = uvicorn.Server(uvicorn.Config(application, http=server._Timed, lifespan="off", log_level="error"))
    with server.listening(None) as place:
        thread = threading.Thread(target=lambda: serving.run(sockets=[place]))
        thread.start()
        with socket.create_connection(place.getsockname(), timeout=20) as client:
            client.sendall(sent)
            answers = b""
            try:
                while part := client.recv(1000):
                    answers += part
            except ConnectionResetError:
                pass
        assert answers.count(b"HTTP/1.1 204") == (sent.count(b"\r\n\r\nGET"))
        serving.should_exit = True
        thread.join(20)
        assert not thread.is_alive()


def test_a_studio_that_nobody_asks_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    access, serving = server.Access(1, print), uvicorn.Server(uvicorn.Config("x"))
    assert server.IDLE == 12 * 3600.0
    monkeypatch.setattr(server, "IDLE", 0.2)
    access.last = time.monotonic() + 0.2
    begun = time.monotonic()
    server.end_when_idle(serving, access)
    assert serving.should_exit
    assert time.monotonic() - begun >= 0.4


# --- names

NAMES = ("Q1/tests", "Q1/correlations", "100%", "a%2Fb", "a#b", "?x&y=1", "..", "+ +", "ä ☉ 点", "Q1")


@pytest.mark.slow
def test_points_of_any_name_can_be_opened(browser: Any, solved: Path, tmp_path: Path) -> None:
    with open_project(solved) as plain:
        network = plain.store.network()
    free = [k for k, name in enumerate(network.points.ids) if name.startswith("TIE")][: len(NAMES)]
    ids = list(network.points.ids)
    for k, name in zip(free, NAMES, strict=True):
        ids[k] = name
    images = tuple(replace(one, name=name) for one, name in zip(network.images, ("I/ground", "100 % #?ü"), strict=True))
    named = replace(network, images=images, points=replace(network.points, ids=Names.of(ids)), shifts=None)
    with Project.create(tmp_path / "project", "names", ProjectSettings()) as project:
        new = [NewImage(KnownImage(image, prior)) for image, prior in zip(images, network.priors, strict=True)]
        store_unadjusted(project.store, Addition(tuple(new), named))
        project.record("init", "names", {})
    assert call("project", "solve", tmp_path / "project", "--no-figures") == 0
    with studio(tmp_path / "project") as running:
        known = running.browser()
        for name in NAMES:
            asked = f"name={quote(name, safe='')}"
            assert known.json(f"/api/point?{asked}")["name"] == name
            assert known.json(f"/api/point/tests?{asked}")["rays"]
            assert known.json(f"/api/point/correlations?{asked}")["rows"]
            assert known.json("/api/questions", {"points": [name]})[0]["record"]["point"] == name
            known.json("/api/changes", {"kind": "reject", "point": name, "image": images[0].name})
            known.json("/api/changes", {"kind": "undo"})
        for image in images:
            asked = f"name={quote(image.name, safe='')}"
            assert known.json(f"/api/image?{asked}")["name"] == image.name
            assert known.json(f"/api/image/ground?{asked}&line=5&sample=5")["others"] is not None
            assert known.json(f"/api/map/residuals?image={quote(image.name, safe='')}")["image"] == image.name
        seen = Page(browser, running)
        seen.show("point")
        for name in NAMES:
            seen.run("name => studio.select(name)", name)
            seen.until("name => document.querySelector('#point h2')?.textContent.startsWith(`${name}: `)", name)
            seen.until("document.querySelectorAll('#point table').length >= 2")
        seen.close()
