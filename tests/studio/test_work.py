"""Long work from the studio: jobs, their end and what they leave; the verdict with its reasons; the first screen."""

import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from projects import files_of
from studio_server import CONTRAST, PANELS, Browser, Page, studio

from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.errors import InputError
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.project import edits
from mgsgraph.project.changes import solve_project
from mgsgraph.project.project import open_project
from mgsgraph.studio import server
from mgsgraph.studio.changes import change
from mgsgraph.studio.lists import window
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.start import verdict_record, worst_record
from mgsgraph.studio.work import Work


@pytest.fixture
def folder(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "project"))


def ended(record: Callable[[], Any], seconds: float = 120.0) -> Any:
    """The record of a job, when it has ended."""
    until = time.monotonic() + seconds
    while (found := record())["state"] == "running":
        assert time.monotonic() < until, found
        time.sleep(0.05)
    return found

def processes(words: str) -> list[str]:
    """Running commands with a word."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if words in line:
            found.append(line)
    return found


# --- what is prepared


def prepared(opened: Opened) -> None:
    """All that is computed before it is asked for; then the studio ends."""
    ended = threading.Event()
    thread = threading.Thread(target=server.prepare, args=(opened, ended))
    thread.start()
    until = time.monotonic() + 120.0
    while opened._prepared != opened.revision or any(one["at_once"] for one in window(opened, {})["missing"]):
        assert time.monotonic() < until
        time.sleep(0.02)
    ended.set()
    thread.join(60.0)
    assert not thread.is_alive()


def test_preparing_leaves_the_folder_alone_and_the_first_change_begins_with_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, before = Path(shutil.copytree(folder, tmp_path / "other")), files_of(folder)
    opened = Opened(folder)
    prepared(opened)
    assert files_of(folder) == before
    point, image = next((row[0], row[1]) for row in window(opened, {"table": "measurements", "count": "1"})["rows"])
    content_of_change = {"kind": "reject", "point": point, "image": image}
    expected = change(Opened(other), content_of_change)
    with monkeypatch.context() as patched:
        patched.setattr(IncrementalAdjustment, "__init__", lambda *_: pytest.fail("read anew"))
        found = change(opened, content_of_change)
        assert {**found, "warning": ""} == {**expected, "warning": ""}  # which names the folder
        with pytest.raises(InputError):
            change(opened, content_of_change)
    with open_project(folder, write=True) as project:  # as another process would
        edits.accept(project, point, image)
    opened.notice()
    for _ in range(2):  # what was in memory is of no use then; the second finds it done
        opened.prepare_change()
        monkeypatch.setattr(IncrementalAdjustment, "__init__", lambda *_: pytest.fail("read anew"))
    assert change(opened, content_of_change)["kind"] == "reject"


def test_nothing_is_prepared_while_a_change_is_under_way_and_another_process_may_change_it(folder: Path) -> None:
    opened = Opened(folder)
    with opened._changing:  # a change is under way
        opened.prepare_change()
    assert opened._prepared != opened.revision
    with open_project(folder, write=True):  # another process is changing it
        opened.prepare_change()
    assert opened._prepared == opened.revision


# --- jobs


def test_a_cancelled_job_leaves_the_project_and_others_wait(folder: Path) -> None:
    before, project = files_of(folder), str(folder)
    with studio(folder) as running:
        one, two = running.browser("one"), running.browser("two")
        assert one.json("/api/work", {"kind": "solve"})["job"]["state"] == "running"
        for browser, path, body in (
            (one, "/api/work", {"kind": "solve"}), (one, "/api/changes", {"kind": "undo"}),
            (two, "/api/work", {"kind": "cancel"}), (two, "/api/work", {"kind": "align"}),
        ):  # fmt: skip
            assert browser.refused(path, body)
        assert "Solve" in one.refused("/api/changes", {"kind": "undo"})
        assert one.json("/api/state")["job"]["title"] == "Solve"
        one.json("/api/work", {"kind": "cancel"})
        assert ended(lambda: one.json("/api/state")["job"])["state"] == "cancelled"
        assert processes(f"solve {project}") == []
        assert files_of(folder) == before
        assert one.json("/api/state")["revision"] == 0
        one.json("/api/work", {"kind": "solve"})  # and the next one may begin
        done = ended(lambda: one.json("/api/state")["job"])
        assert done["state"] == "done", done
        assert done["lines"]
        assert one.json("/api/state")["revision"] == 1
    with open_project(folder) as changed:
        assert [change.verb for change in changed.changes()].count("solve") == 2


@pytest.fixture
def hung_up() -> Iterator[None]:
    """Commands end when their terminal does: not so below nohup, where it is ignored by all that is started."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hung_up")
def test_a_job_ends_with_its_studio(folder: Path) -> None:
    before = files_of(folder)
    with studio(folder) as running:
        running.browser("one").json("/api/work", {"kind": "solve"})
        until = time.monotonic() + 20.0
        while not processes(f"solve {folder}"):
            assert time.monotonic() < until
        running.process.kill()
        running.process.wait()
        until = time.monotonic() + 20.0
        while processes(f"solve {folder}"):
            assert time.monotonic() < until
            time.sleep(0.05)
    assert files_of(folder) == before


def test_files_are_added_by_their_numbers(pair_folder: Path, folder: Path, tmp_path: Path) -> None:
    given = tmp_path / "given"
    given.mkdir()
    shutil.copy(next(pair_folder.glob("*.pvl")), given / "network.pvl")
    (given / "other.txt").write_text("no image")
    work = Work(Opened(folder), given)
    assert [one["name"] for one in work.files()] == ["network.pvl"]
    for numbers in ([], [1], [-1], ["network.pvl"], [0.5], "0", None):
        with pytest.raises(Exception, match="work, files"):
            work.start("add", numbers)
    (given / "a.net").write_bytes(b"")  # a number stays that of its file
    assert [one["name"] for one in work.files()] == ["network.pvl", "a.net"]
    work.start("add", [1])
    failed = ended(lambda: work.record)
    assert failed["state"] == "failed"
    assert "a.net" in failed["lines"][-1]


def test_results_and_cases_have_no_work(case_file: Path) -> None:
    work = Work(Opened(case_file))
    with pytest.raises(Exception, match="a project"):
        work.start("solve")
    assert work.record is None
    reasons = worst_record(Opened(case_file))
    assert all(reasons["reasons"].values())
    assert str(case_file) in reasons["command"]


def test_only_ties_in_the_window_are_kept(pair_folder: Path, folder: Path, tmp_path: Path) -> None:
    opened = Opened(folder)
    shutil.copy(next(pair_folder.glob("*.pvl")), tmp_path / "network.pvl")
    ties, ids = read_tie_points(tmp_path / "network.pvl"), opened.block().network.points.ids
    plane: Array = opened.map_places(opened.block().places[ids.find(list(ties.ids))])
    middle = float(np.sort(plane[:, 1])[9:11].mean())
    box = np.array([*plane.min(axis=0), plane[:, 0].max(), middle]) + np.array([-5e3, -5e3, 5e3, 0.0])
    kept = read_tie_points(Work(opened)._found(tmp_path, box))
    expected = {name for name, place in zip(ties.ids, plane, strict=True) if place[1] <= middle}
    assert len(set(kept.ids) ^ expected) <= 2  # the ground of a single ray is not that of the point


# --- verdict and first screen


@pytest.fixture(scope="module")
def suspect(solved: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A solved project with a blunder, and the name of its point."""
    folder = Path(shutil.copytree(solved, tmp_path_factory.mktemp("suspect") / "project"))
    with open_project(folder, write=True) as project:
        network = project.store.network()
        name = network.points.ids[int(np.flatnonzero(network.points.classes == PointClass.TIE)[3])]
        state = edits.point_state(project, name)
        assert state is not None
        measure = state.measures[0]
        edits.move(project, name, measure.image, measure.line + 60.0, measure.sample)
        solve_project(project, figures=False)
    return folder, name


def test_reasons_lead_to_the_points(suspect: tuple[Path, str]) -> None:
    opened = Opened(suspect[0])
    found = verdict_record(opened)
    assert found["state"] == "suspect"
    named = {(link["kind"], link["name"]) for reason in found["reasons"] for link in reason["links"]}
    assert ("point", suspect[1]) in named
    assert all(reason["links"] for reason in found["reasons"])
    worst = worst_record(opened)
    assert suspect[1] in [one["point"] for one in worst["measurements"]]
    sizes = [one["residual_sigmas"] for one in worst["measurements"]]
    assert sizes == sorted(sizes, reverse=True)
    assert len(worst["measurements"]) == len(worst["points"]) == 5


def test_verdict_keys_and_undo_in_the_page(suspect: tuple[Path, str], tmp_path: Path, browser: Any) -> None:
    with studio(Path(shutil.copytree(suspect[0], tmp_path / "project"))) as running:
        seen = Page(browser, running, color_scheme="dark")
        seen.until("document.getElementById('verdict').dataset.state === 'suspect'")
        seen.show("start")
        assert seen.run(CONTRAST) == []
        seen.run("document.getElementById('help').focus()")
        seen.tab.keyboard.press("v")
        seen.tab.locator("#reasons").get_by_role("button", name=suspect[1], exact=True).first.click()
        seen.until("name => document.querySelector('#point h2')?.textContent.startsWith(`${name}:`)", suspect[1])
        assert not seen.tab.locator("#reasons").is_visible()
        assert suspect[1] in seen.tab.locator("#now").inner_text()
        for key, other in (("u", "redo"), ("U", "undo")):
            revision = seen.run("studio.scene.revision")
            seen.until("key => !document.getElementById(key).disabled", {"u": "undo", "U": "redo"}[key])
            seen.run("document.activeElement.blur()")
            seen.tab.keyboard.press(key)
            seen.until("revision => studio.scene.revision > revision && studio.last", revision)
            seen.until("key => !document.getElementById(key).disabled", other)
        assert seen.run("studio.last.kind") == "redo"
        seen.until("document.getElementById('verdict').dataset.state === 'not tested'")  # until the next solution
        seen.run("document.getElementById('help').focus()")
        seen.tab.keyboard.press("Enter")
        box = seen.tab.locator("#keys").bounding_box()
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= 800
        seen.tab.keyboard.press("Escape")
        assert seen.run("document.activeElement.id") == "help"
        seen.close()


@pytest.fixture(params=["results", "case"])
def bare(request: pytest.FixtureRequest, solved: Path, case_file: Path) -> Path:
    return solved / "solutions" / "0001" if request.param == "results" else case_file


def test_every_panel_says_something_of_what_can_not_be_changed(bare: Path, browser: Any) -> None:
    with studio(bare) as running:
        seen = Page(browser, running, width=380)
        for panel in PANELS:
            if panel == "lists":
                continue
            seen.show(panel)
            seen.until("panel => document.getElementById(panel).innerText.trim().length > 40", panel)
            assert seen.run("document.documentElement.scrollWidth") <= 380, panel
            assert seen.run(CONTRAST) == [], panel
        seen.show("start")
        seen.until("document.querySelector('#start code')")
        assert seen.tab.get_by_role("button", name="Solve").is_disabled()
        refused = seen.run("studio.request('/api/work', {kind: 'solve'}).then(() => '', error => error.message)")
        assert refused
        seen.close()


def test_a_height_difference_by_two_clicks(folder: Path, browser: Any) -> None:
    with studio(folder) as running:
        seen = Page(browser, running)
        found = seen.run("studio.request('/api/worst')")
        seen.show("start")
        names = [one["id"] for one in found["points"][:2]]
        for name in names:
            seen.run("name => studio.select(name)", name)
        asked = Browser.json(running.browser(), "/api/questions", {"pairs": [names]})[0]["record"]
        seen.run("document.activeElement.blur()")
        seen.tab.keyboard.press("d")
        seen.until("document.getElementById('say').textContent.includes(' m')")
        words = seen.tab.locator("#say").inner_text().replace("−", "-").split()
        numbers = [float(word) for word in words if word.replace(".", "").replace("-", "").isdigit()]
        assert numbers[0] == pytest.approx(asked["height_difference_m"], rel=0.01)
        assert numbers[1] == pytest.approx(asked["height_sigma_m"], rel=0.01)
        seen.close()
