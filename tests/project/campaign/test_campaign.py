"""Campaigns: what is due is done, what fails is told, on a cluster as well as here."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import mgsgraph
from mgsgraph.adjustment.cluster.connection import Lost
from mgsgraph.atomic_write import beside
from mgsgraph.errors import InputError, SolverError
from mgsgraph.project.campaign import run as campaign_run
from mgsgraph.project.campaign.record import AS_WRITTEN, RECORD, CampaignEntry, Overrides
from mgsgraph.project.campaign.run import Campaign, line, run_campaign, summary
from mgsgraph.results.results import write_results

TABLES = ("points.csv", "orientation.csv", "residuals.csv")
QUICK = Overrides(figures=False)


@pytest.fixture
def sites(case_file: Path, tmp_path: Path) -> Path:
    """Three sites, of which one has no network."""
    folder = tmp_path / "sites"
    for name in ("north", "south", "west"):
        shutil.copytree(case_file.parent, folder / name)
    (folder / "west" / "network.pvl").unlink()
    return folder


Run = Callable[..., tuple[Campaign, set[str]]]


@pytest.fixture
def run(sites: Path, tmp_path: Path) -> Run:
    """Run the campaign and tell the folders of the cases that were done now."""

    def run(overrides: Overrides = QUICK, **options: Any) -> tuple[Campaign, set[str]]:
        now: list[CampaignEntry] = []
        out = tmp_path / "out"
        done = run_campaign(
            [sites], out, overrides, progress=lambda over, due, one: now.extend([one] if one else []), **options
        )
        lines = (out / RECORD).read_text(encoding="utf-8").splitlines()[1:]
        assert [json.loads(text)["folder"] for text in lines[len(lines) - len(now) :]] == [one.folder for one in now]
        return done, {one.folder for one in now}

    return run


def test_a_failed_case_does_not_stop_the_others(run: Run, sites: Path, tmp_path: Path) -> None:
    done, now = run()
    assert now == {"north", "south", "west"}
    assert {one.folder: one.status for one in done.entries} == {"north": "done", "south": "done", "west": "failed"}
    assert not done.well
    failure = done.entries[2]
    assert "network.pvl" in failure.message
    assert "no such file" in failure.message
    assert "network.pvl" not in failure.checksums
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [RECORD, "north", "south"]
    good = done.entries[0]
    solution = mgsgraph.read_solution(tmp_path / "out" / "north")
    assert good.cost == solution.cost_final
    assert good.sigma0 == solution.sigma0
    assert good.iterations == solution.iterations
    assert summary(done).startswith("3 cases: 2 done, 1 failed\n")
    assert "\n- west: failed after" in summary(done)


def test_products_are_those_of_adjust(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    write_results(mgsgraph.adjust(mgsgraph.read_case(sites / "north" / "case.toml")), tmp_path / "alone", figures=False)
    assert {p.name for p in (tmp_path / "out" / "north").iterdir()} == {p.name for p in (tmp_path / "alone").iterdir()}
    for name in TABLES:
        assert (tmp_path / "out" / "north" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def test_what_is_done_and_unchanged_is_left(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    stamp = (tmp_path / "out" / "north" / "solution.json").stat().st_mtime_ns
    again, now = run()
    assert not now
    assert len(again.kept) == 3
    assert "3 of them earlier" in summary(again)
    assert (tmp_path / "out" / "north" / "solution.json").stat().st_mtime_ns == stamp
    (sites / "north" / "case.toml").touch()  # a newer file with the same content
    assert not run()[1]


def test_what_has_changed_is_done_again(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    network = sites / "south" / "network.pvl"
    network.write_text(network.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert run()[1] == {"south"}
    case = sites / "north" / "case.toml"
    case.write_text(case.read_text(encoding="utf-8") + "# looked at\n", encoding="utf-8")
    assert run()[1] == {"north"}
    shutil.rmtree(tmp_path / "out" / "south")
    assert run()[1] == {"south"}
    assert run(Overrides(figures=False, laser=False))[1] == {"north", "south", "west"}
    shutil.copy(network, sites / "west" / "network.pvl")
    done, now = run(Overrides(figures=False, laser=False))
    assert now == {"west"}
    assert done.well
    assert mgsgraph.read_solution(tmp_path / "out" / "west").network.ranges.point.size == 0


def test_failures_are_tried_again_on_request(run: Run) -> None:
    run()
    assert run(retry=True)[1] == {"west"}
    done, now = run(Overrides(figures=False, reject=1.0))
    assert now == {"north", "south", "west"}
    assert done.count("failed") == 3
    assert "at least 2 standard deviations" in done.entries[0].message
    assert "what is in north is from before" in done.entries[0].message


def test_a_case_that_does_not_converge_is_told(run: Run, sites: Path, tmp_path: Path) -> None:
    case = sites / "north" / "case.toml"
    case.write_text(case.read_text(encoding="utf-8") + "\n[solver]\nmax_iterations = 1\n", encoding="utf-8")
    done, _ = run()
    assert done.entries[0].status == "not converged"
    assert (tmp_path / "out" / "north" / "solution.json").exists()
    assert "raise max_iterations" in summary(done)
    assert run()[1] == set()
    assert run(retry=True)[1] == {"north", "west"}


def test_a_fault_of_the_program_is_one_failed_case(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    read = campaign_run.read_case

    def faulty(path: Path, laser: bool = True) -> Any:
        if path.parent.name == "north":
            raise ZeroDivisionError("division\nby zero")
        return read(path, laser)

    monkeypatch.setattr(campaign_run, "read_case", faulty)
    done, _ = run()
    assert [one.status for one in done.entries] == ["failed", "done", "failed"]
    assert "unforeseen ZeroDivisionError: division by zero" in done.entries[0].message
    assert "\n" not in line(done.entries[0])


def test_leftovers_of_a_killed_worker_are_swept(run: Run, tmp_path: Path) -> None:
    leftover, foreign = beside(Path("north")).name, ".north.0a1b2c3d.mine"
    run()
    for name in (leftover, foreign):
        (tmp_path / "out" / name).mkdir()
    run(Overrides(figures=False, laser=False))
    assert not (tmp_path / "out" / leftover).exists()
    assert (tmp_path / "out" / foreign).exists()


def test_a_campaign_that_moved_as_a_whole_is_known(run: Run, sites: Path, tmp_path: Path) -> None:
    run()
    moved = tmp_path / "moved"
    moved.mkdir()
    shutil.move(sites, moved / "sites")
    shutil.move(tmp_path / "out", moved / "out")
    now: list[CampaignEntry | None] = []
    run_campaign([moved / "sites"], moved / "out", QUICK, progress=lambda over, due, one: now.append(one))
    assert not now


def test_as_written_changes_nothing() -> None:
    chosen = mgsgraph.SolverSettings(line="measured", reject=4.0)
    assert AS_WRITTEN.over(chosen) == chosen
    assert Overrides(reject=0.0, loss="huber").over(chosen) == mgsgraph.SolverSettings(line="measured", loss="huber")


# --- on a cluster


@pytest.mark.slow
def test_on_a_cluster_the_same(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
    run()
    shutil.move(tmp_path / "out", tmp_path / "here")
    done, now = run(cluster="local:2")
    assert now == {"north", "south", "west"}
    assert [one.status for one in done.entries] == ["done", "done", "failed"]
    for name in TABLES:
        assert (tmp_path / "out" / "north" / name).read_bytes() == (tmp_path / "here" / "north" / name).read_bytes()
    assert not run(cluster="tcp://127.0.0.1:9")[1]  # nothing is due, and nobody is asked


def test_what_was_over_when_the_cluster_went_is_recorded(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def hands(*_: object) -> Iterator[Any]:
        def each(function: Callable[[Any], Any], orders: Any) -> Iterator[tuple[int, Any]]:
            yield 1, function(orders[1])
            yield 2, Lost("each of the 4 workers that tried it died")
            raise SolverError("the scheduler has gone")

        yield each

    with monkeypatch.context() as patched:
        patched.setattr("mgsgraph.project.campaign.run._workers", hands)
        with pytest.raises(SolverError, match="has gone"):
            run()
    done, now = run()
    assert now == {"north"}
    assert [one.status for one in done.entries] == ["done", "done", "failed"]
    assert done.entries[2].message.startswith("each of the 4 workers")


def test_a_cluster_that_is_not_there_leaves_nothing(sites: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no place for the work"):
        run_campaign([sites], tmp_path / "out", QUICK, cluster="dask")
    assert not (tmp_path / "out").exists()
