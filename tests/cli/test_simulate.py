"""`mgsgraph simulate` of campaigns, as a person uses it, in processes of their own."""

import json
from pathlib import Path

import pytest
from commands import refused, run


def test_a_strip_with_its_steps_adjusts(tmp_path: Path) -> None:
    out = tmp_path / "strip"
    done = run("simulate", "strip", "--images", 4, "--ties", 20, "--steps", "--out", out)
    assert done.returncode == 0, done.stderr
    assert str(out / "case.toml") in done.stdout
    assert sorted(path.name for path in out.glob("step_*")) == ["step_000", "step_001", "step_002", "step_003"]
    assert len(json.loads((out / "truth.json").read_text())["ties"]) == 60
    assert len(list(out.glob("image_*.isd"))) == 4
    done = run("adjust", out / "case.toml", "--out", tmp_path / "results", "--no-figures")
    assert done.returncode == 0, done.stderr
    assert "4 images" in done.stdout or "STRIP/003X" in done.stdout


def test_a_strip_without_steps_has_none(tmp_path: Path) -> None:
    done = run("simulate", "strip", "--images", 2, "--ties", 20, "--out", tmp_path / "strip")
    assert done.returncode == 0, done.stderr
    assert not list((tmp_path / "strip").glob("step_*"))


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("gusev", "--images", 4), "images: given for gusev; expected the site strip"),
        (("pair", "--ties", 4), "ties: given for pair"),
        (("three-sites", "--steps"), "steps: given for three-sites"),
        (("archive", "--steps"), "steps: given for archive"),
        (("strip", "--kind", "moc"), "kind: given for strip; expected the site archive"),
        (("archive", "--kind", "themis"), "kind: 'themis'; expected kaguya, ctx, moc, dense or block"),
        (("strip", "--images", 1), "images: 1; expected a whole number, at least 2"),
        (("strip", "--images", 501), "images: 501; expected 2 .. 500"),
        (("strip", "--ties", 0), "ties: 0"),
        (("gusev", "--attitude-time-bias", 1), "SimulationOptions has it"),
    ],
)
def test_options_are_refused_where_they_mean_nothing(args: tuple[object, ...], says: str, tmp_path: Path) -> None:
    refused(run("simulate", *args, "--out", tmp_path / "x"), says)
    assert not list(tmp_path.iterdir())


def test_campaigns_are_simulated_but_not_demonstrated(tmp_path: Path) -> None:
    refused(run("demo", "strip", "--out", tmp_path / "x"), "'strip'; expected eos, gusev, isidis or pair")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_three_sites_are_written_with_a_folder_for_each(tmp_path: Path) -> None:
    out = tmp_path / "three"
    done = run("simulate", "three-sites", "--no-pictures", "--out", out)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in out.iterdir()) == [
        "case.toml", "eos", "gusev", "image_BRIDGE.isd", "isidis", "network.pvl", "truth.json",
    ]
    assert list(json.loads((out / "truth.json").read_text())["coefficients"]) == ["BRIDGE"]


def test_an_archive_is_written_and_adjusts(tmp_path: Path) -> None:
    out = tmp_path / "archive"
    done = run("simulate", "archive", "--kind", "moc", "--images", 6, "--ties", 100, "--out", out)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in out.iterdir()) == [
        "case.toml", "isd", "network.net", "true_corrections.npz", "true_points.parquet", "truth.json",
    ]
    done = run("adjust", out / "case.toml", "--out", tmp_path / "results", "--no-figures")
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout
