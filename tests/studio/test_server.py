"""The studio's server: who may ask, what it answers, and that nothing that was stored is lost."""

import shutil
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from commands import call

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio_server import Browser, Studio, studio

from mgsgraph.cli import group
from mgsgraph.project.edits import point_state
from mgsgraph.project.project import open_project
from mgsgraph.results.archive import read_solution
from mgsgraph.studio.point_sheet import CHIP, chip


@pytest.fixture(scope="module")
def running(solved: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    with studio(Path(shutil.copytree(solved, tmp_path_factory.mktemp("running") / "project"))) as found:
        yield found


@pytest.fixture(scope="module")
def browser_(running: Studio) -> Browser:
    return running.browser("one")


# --- who may ask


def test_without_the_token_nothing_is_answered(running: Studio) -> None:
    stranger = Browser(running.root)
    for path in ("/", "/api/scene", "/page/main.js", "/?token=wrong", "/api/changes"):
        assert stranger.ask(path)[0] == 403
    assert stranger.ask("/api/changes", {"kind": "undo"})[0] == 403


def test_other_hosts_and_origins_are_refused(running: Studio, browser_: Browser) -> None:
    """A page elsewhere, whose name resolves to this machine, or that sends a form."""
    assert browser_.ask("/api/scene", headers={"Host": "evil.example"})[0] == 421
    assert browser_.ask("/api/changes", {"kind": "undo"}, {"Origin": "http://evil.example"})[0] == 403
    assert browser_.ask("/api/changes", {"kind": "undo"}, {"Origin": ""})[0] == 403
    port = int(running.root.rpartition(":")[2])
    with socket.socket() as outside:
        outside.settimeout(2.0)
        assert outside.connect_ex(("127.0.0.2", port)) != 0


def test_nothing_comes_from_outside_and_the_cookie_is_no_scripts(running: Studio) -> None:
    status, headers, _ = running.browser().ask("/")
    assert status == 200
    assert headers["content-security-policy"].startswith("default-src 'self'")
    page = Path("mgsgraph/studio/page")
    page = page if page.is_dir() else Path(__file__).parents[2] / page
    for file in page.iterdir():
        text = file.read_text(encoding="utf-8")
        assert "http://" not in text.replace("http://www.w3.org", "")
        assert "https://" not in text
        assert "innerHTML" not in text


def test_a_taken_port_is_one_line(running: Studio, solved: Path) -> None:
    port = running.root.rpartition(":")[2]
    run = CliRunner().invoke(group, ["studio", str(solved), "--no-browser", "--port", port])
    assert run.exit_code != 0
    assert "--port" in str(run.exception)


@pytest.mark.parametrize("what", ["nothing", "empty", "text"])
def test_what_is_none_of_ours_is_one_line(what: str, tmp_path: Path) -> None:
    path = tmp_path / "x"
    if what == "empty":
        path.mkdir()
    elif what == "text":
        path.write_text("hello", encoding="utf-8")
    run = CliRunner().invoke(group, ["studio", str(path), "--no-browser"])
    assert run.exit_code != 0
    assert len(str(run.exception).splitlines()) == 1


# --- the map


def test_points_of_the_map_are_those_of_the_solution(browser_: Browser, solved: Path) -> None:
    solution = read_solution(solved / "solutions" / "0001")
    scene = browser_.json("/api/scene")
    x0, y0, x1, y1 = scene["map"]["bounds_m"]
    box = f"x0={x0 - 1}&y0={y0 - 1}&x1={x1 + 1}&y1={y1 + 1}&w=800&h=600"
    found = browser_.json(f"/api/map/points?{box}&value=sigma")
    assert found["form"] == "points"
    assert found["count"] == np.count_nonzero(solution.determined)
    sigmas = np.linalg.norm(solution.sigmas, axis=1)
    for name, value in zip(found["names"], found["values"], strict=True):
        (k,) = solution.network.points.ids.find([name])
        assert value == pytest.approx(sigmas[k], rel=1e-5)
    places = np.array([found["x"], found["y"]]).T
    first, second = (int(solution.network.points.ids.find([found["names"][k]])[0]) for k in (0, 1))
    apart = np.linalg.norm(places[0] - places[1])
    assert apart == pytest.approx(np.linalg.norm(solution.places[first] - solution.places[second]), rel=1e-2)
    names = {one["name"] for one in scene["values"]}
    for value in sorted(names):
        every = browser_.json(f"/api/map/points?{box}&value={value}")
        assert any(one is not None for one in every["values"]), value


def test_selections(browser_: Browser) -> None:
    every = browser_.json("/api/select?value=sigma")
    values = every["values"]
    assert values == sorted(values, reverse=True)
    least = values[len(values) // 2]
    some = browser_.json(f"/api/select?value=sigma&least={least}")
    assert some["count"] <= every["count"]
    assert min(some["values"]) >= least * (1.0 - 1e-5)
    assert browser_.json("/api/select?value=wtest&least=0")["count"] > 0
    x, y = every["places"][0]
    near = browser_.json(f"/api/select?x0={x - 1}&y0={y - 1}&x1={x + 1}&y1={y + 1}")
    assert every["names"][0] in near["names"]


@pytest.mark.parametrize("kind", ["svg", "png", "pdf"])
def test_the_window_of_the_map_is_a_figure(kind: str, browser_: Browser) -> None:
    x0, y0, x1, y1 = browser_.json("/api/scene")["map"]["bounds_m"]
    asked = f"x0={x0}&y0={y0}&x1={x1}&y1={y1}&w=800&h=600&value=moved_up&layers=footprints,points,ellipses,moved,relief"
    status, heads, data = browser_.ask(f"/api/map/figure?kind={kind}&{asked}&factor=3")
    assert status == 200, data[:300]
    assert f"map.{kind}" in heads["content-disposition"]
    assert data == browser_.ask(f"/api/map/figure?kind={kind}&{asked}&factor=3")[2]
    for said in {"svg": (b"dc:title", b"dc:description"), "pdf": (b"/Subject",)}.get(kind, ()):
        assert said in data
    assert data.lstrip()[:5] in (b"<?xml", b"%PDF-") or data.startswith(b"\x89PNG")


@pytest.mark.parametrize("path", [
    "/api/map/figure?kind=gif&x0=0&y0=0&x1=1&y1=1", "/api/map/figure?kind=svg&x0=0&y0=0&x1=1&y1=1&layers=nothing",
    "/api/map/figure?kind=svg&x0=0&y0=0&x1=1&y1=1&factor=-1",
    "/api/map/points?x0=0&y0=0&x1=0&y1=1", "/api/map/points?x0=a&y0=0&x1=1&y1=1", "/api/select?least=x",
    "/api/map/points?x0=0&y0=0&x1=1&y1=1&value=nothing", "/api/map/points?x0=0&y0=0&x1=1&y1=1&classes=nothing",
    "/api/map/residuals?image=nowhere", "/api/point?name=nobody", "/api/point/tests?name=nobody",
    "/api/image?name=nowhere",
    "/api/chip.png?image=nowhere&line=1&sample=1",
    "/api/image/ground?name=none&line=1&sample=1", "/api/image/contrast?name=none&line0=1&sample0=1&line1=2&sample1=2",
    "/api/image/tile.png?name=none&level=0&row=0&column=0&low=0&high=1",
])  # fmt: skip
def test_bad_requests_are_one_line(path: str, browser_: Browser) -> None:
    browser_.refused(path)


@pytest.mark.parametrize("body", [
    b"{", b"[]", {"kind": "nothing"}, {"kind": 3},
    {"kind": "move", "point": "nobody", "image": "x", "line": 1, "sample": 1},
    {"kind": "move", "point": "nobody", "image": "x", "line": "1", "sample": 1}, {"kind": "measure", "measures": 4},
    {"kind": "measure", "point": "x", "measures": [{"image": "nowhere", "line": 1.0, "sample": 1.0}]},
    {"kind": "hold", "point": "nobody", "longitude_deg": 1}, {"kind": "undo"}, b" " * 300_000,
])  # fmt: skip
def test_bad_changes_are_one_line_and_change_nothing(body: Any, browser_: Browser) -> None:
    before = browser_.json("/api/state")["revision"]
    browser_.refused("/api/changes", body)
    assert browser_.json("/api/state")["revision"] == before


# --- changes


def a_tie(browser_: Browser) -> tuple[str, dict[str, Any]]:
    name = browser_.json("/api/select?value=sigma&classes=tie")["names"][0]
    return name, browser_.json(f"/api/point?name={name}")


def test_the_sheet_says_what_the_solution_knows(browser_: Browser, solved: Path) -> None:
    solution = read_solution(solved / "solutions" / "0001")
    name, sheet = a_tie(browser_)
    (k,) = solution.network.points.ids.find([name])
    for ray in sheet["rays"]:
        j = solution.network.image_names.index(ray["image"])
        (row,) = np.flatnonzero((solution.network.rays.point == k) & (solution.network.rays.image == j))
        np.testing.assert_allclose(ray["residual_px"], solution.residuals[row], atol=1e-5)
    tests = browser_.json(f"/api/point/tests?name={name}")["rays"]
    assert {ray["image"] for ray in sheet["rays"]} == set(tests)
    assert all(0.0 <= one <= 1.0 for ray in tests.values() for one in ray["redundancy"])
    along = browser_.json(f"/api/point/correlations?name={name}")["rows"]
    assert all(abs(value) <= 1.0 + 1e-9 for row in along for value in row["correlation"])


def test_a_change_is_stored_adjusted_and_undone(running: Studio, browser_: Browser) -> None:
    name, sheet = a_tie(browser_)
    ray = sheet["rays"][0]
    body = {"kind": "move", "point": name, "image": ray["image"], "line": ray["line"] + 3.0, "sample": ray["sample"]}
    done = browser_.json("/api/changes", body)
    assert done["revision"] == browser_.json("/api/scene")["revision"]
    assert name in [one["name"] for one in done["moved"]]
    after = browser_.json(f"/api/point?name={name}")
    assert next(one for one in after["rays"] if one["image"] == ray["image"])["line"] == ray["line"] + 3.0
    assert after["edited"]
    browser_.json("/api/changes", {"kind": "undo"})
    again = browser_.json(f"/api/point?name={name}")
    assert again["place"]["longitude_deg"] == pytest.approx(sheet["place"]["longitude_deg"], abs=1e-7)


def test_a_second_browser_reads_and_may_take_over(running: Studio, browser_: Browser) -> None:
    name, sheet = a_tie(browser_)
    ray = sheet["rays"][0]
    body = {"kind": "reject", "point": name, "image": ray["image"]}
    second = running.browser("two")
    second.refused("/api/changes", {"kind": "reject", "point": "nobody", "image": "x"})  # which keeps nobody out
    browser_.json("/api/changes", body)
    state = second.json("/api/state")
    assert not state["writable"]
    assert state["lock"]
    assert second.json("/api/scene")["name"]
    second.refused("/api/changes", {"kind": "undo"})
    second.json("/api/changes", {"kind": "take over"})
    second.json("/api/changes", {"kind": "undo"})
    browser_.refused("/api/changes", body)
    browser_.json("/api/changes", {"kind": "take over"})


def test_another_process_has_the_project(running: Studio, browser_: Browser) -> None:
    name, sheet = a_tie(browser_)
    ray = sheet["rays"][0]
    path = Path(browser_.json("/api/scene")["path"])
    with open_project(path, write=True):
        sentence = browser_.refused("/api/changes", {"kind": "reject", "point": name, "image": ray["image"]})
    assert "another" in sentence


def test_what_another_process_has_changed_is_noticed(browser_: Browser) -> None:
    scene = browser_.json("/api/scene")
    with open_project(Path(scene["path"]), write=True) as project:
        project.record("check", "by another process", {})
    found = browser_.json("/api/state")
    assert found["revision"] > scene["revision"]
    assert found["warning"]
    assert browser_.json("/api/scene")["revision"] == found["revision"]
    assert browser_.json("/api/state")["revision"] == found["revision"]


def test_questions_are_answered_as_by_the_command(browser_: Browser, solved: Path) -> None:
    names = browser_.json("/api/select?value=sigma&classes=tie")["names"][:2]
    found = browser_.json("/api/questions", {"points": names[:1], "pairs": [names]})
    run = CliRunner().invoke(group, ["analyze", str(solved), "--pair", *names])
    numbers = [one["record"] for one in found]
    assert numbers[1]["question"] == "pair"
    assert f"{abs(numbers[1]['height_difference_m']):.3g}"[:3] in run.output
    browser_.refused("/api/questions", {})
    browser_.refused("/api/questions", {"points": ["nobody"]})
    browser_.refused("/api/questions", {"poses": [["nowhere"]]})


def test_what_to_measure_next_is_ranked(browser_: Browser) -> None:
    found = browser_.json("/api/plan")
    gains = [one["gain_percent"] for one in found["candidates"]]
    assert gains
    assert max(gains) == gains[0]
    assert all(len(one["images"]) >= 2 for one in found["candidates"])
    places = np.array([one["map_m"] for one in found["candidates"]])
    apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(places), 1)]
    assert apart.min() > 0.02 * np.ptp(places, axis=0).max()  # no two of nearly one place


def test_a_server_that_is_killed_loses_nothing(solved: Path, tmp_path: Path) -> None:
    """While changes come one after another: what was answered is there, and the project is whole."""
    folder = Path(shutil.copytree(solved, tmp_path / "project"))
    done = list[tuple[str, float]]()
    with studio(folder) as running:
        browser_ = running.browser("one")
        names = browser_.json("/api/select?value=sigma&classes=tie")["names"]
        rays = {name: browser_.json(f"/api/point?name={name}")["rays"][0] for name in names[:6]}

        def work() -> None:
            for k in range(1000):
                name = names[k % len(rays)]
                line = rays[name]["line"] + 0.01 * (k + 1)
                body = {"kind": "move", "point": name, "image": rays[name]["image"], "line": line,
                        "sample": rays[name]["sample"]}  # fmt: skip
                try:
                    browser_.json("/api/changes", body)
                except (OSError, AssertionError):
                    return
                done.append((name, line))

        worker = threading.Thread(target=work)
        worker.start()
        while len(done) < 4:
            worker.join(0.05)
        running.process.kill()
        worker.join()
    with open_project(folder) as project:
        changes = [change for change in project.changes() if change.verb == "edit"]
        assert len(changes) in (len(done), len(done) + 1)
        for name, line in dict(done[: len(changes)]).items():
            state = point_state(project, name)
            assert state is not None
            stored = state.of(rays[name]["image"])
            assert stored is not None
            assert stored.line == pytest.approx(line) or len(changes) == len(done) + 1
    assert call("project", "solve", folder, "--no-figures") == 0


# --- other kinds


# above two seconds: two servers in processes of their own
def test_results_and_cases_are_read_alone(solved: Path, case_file: Path) -> None:
    case = case_file
    for path in (solved / "solutions" / "0001", case):
        with studio(path) as running:
            browser_ = running.browser()
            scene = browser_.json("/api/scene")
            assert not browser_.json("/api/state")["writable"]
            assert scene["adjusted"] == (path != case)
            assert len(scene["images"]) == 2
            browser_.refused("/api/changes", {"kind": "undo"})
            if path == case:
                browser_.refused("/api/plan")
                browser_.refused("/api/questions", {"points": ["x"]})


def test_chips_are_pictures(pictured_case: Path) -> None:
    data = chip(pictured_case.with_name("A.tif"), 5.0, 199.0)
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (2 * CHIP + 1, 2 * CHIP + 1)
