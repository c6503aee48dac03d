"""Heights as a person uses them: `mgsgraph dem`, `adjust` with terrain, `footprints`; one line for errors."""

import csv
import json
import re
from pathlib import Path

import dem_site
import matched
import networks
import numpy as np
import profiles
import pytest
import rasterio
from commands import call, refusal, refused, rows_of, run
from outside import refuses
from rasterio.warp import transform

import mgsgraph
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.tie_points import control_network
from mgsgraph.project.reading import oriented_images
from mgsgraph.results import terrain_model
from mgsgraph.results.archive import read_solution
from mgsgraph.results.places import SELECTION
from mgsgraph.units import DEG


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The case of the small pair with pictures and the ties found in them, and its solution beside it as `result`."""
    case = matched.write(tmp_path_factory.mktemp("site"))
    network = control_network(matched.matches().ties, "mgsgraph", "MARS", "pair")
    write_pvl_network(network, case.parent / "network.pvl")
    assert call("adjust", case, "--out", case.parent / "result", "--no-figures") == 0
    return case


@pytest.fixture(scope="module")
def out(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its terrain model, made in a process of its own."""
    out = tmp_path_factory.mktemp("made") / "dem"
    done = run("dem", site.parent / "result", "--case", site, "--out", out, "--spacing", 25)
    assert done.returncode == 0, done.stderr
    assert not done.stderr  # no terminal, no bar
    record = json.loads((out / "dem.json").read_text(encoding="utf-8"))
    said = done.stdout.splitlines()
    assert [line[2:] for line in said if line.startswith("- ")] == record["statements"]
    assert said[-1].startswith(f"The terrain model is {out / 'dem.tif'} (")
    return out


@pytest.mark.slow
def test_the_model_is_true_within_its_sigmas(out: Path) -> None:
    """The whole road, on pictures: the issue's bound is an rms of 1.5 times what is stated."""
    assert {path.name for path in out.iterdir()} == {
        "dem.json", "dem.tif", "ortho.tif", "ortho_sigma.tif", "shots.csv", "dem.stac.json", "dem.png",
    }  # fmt: skip
    with rasterio.open(out / "dem.tif") as file:
        height, sigma = file.read([1, 2])
        rows, columns = np.nonzero(np.isfinite(height))
        x, y = file.xy(rows, columns)
        lon, lat = transform(file.crs, "IAU_2015:49900", list(x), list(y))
    true = matched.site().terrain.ground_radius(*np.radians([lon, lat])) - 3396190.0
    ratio = (height[rows, columns] - true) / sigma[rows, columns]
    assert rows.size > 5000
    assert np.sqrt(np.mean(ratio**2)) < 1.5
    assert np.mean(np.abs(ratio) > 3.0) < 0.04


# ---- without the matching


def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    matches = dem_site.matched(np.random.default_rng(4))
    monkeypatch.setattr(terrain_model, "read_scene", lambda path, *ground: ("test", dem_site.scene()))
    monkeypatch.setattr(terrain_model, "densely_matched", lambda *given: ((matches,), 1e-3))


# above two seconds: a dense model is gridded, checked and written
def test_options_reach_the_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick(monkeypatch)
    shots = dem_site.case_path().parent / "ap18933l.b"
    other = tmp_path / "other.b"
    other.write_bytes(shots.read_bytes())
    out = tmp_path / "dem"
    options = ("--post", 40, "--heights", "areoid", "--shots", other, "--ortho-pixel", 20, "--no-figures")
    assert call("dem", dem_site.result(), "--case", dem_site.case_path(), "--out", out, *options) == 0
    record = json.loads((out / "dem.json").read_text(encoding="utf-8"))
    assert (record["post_m"], record["ortho_pixel_m"], record["heights_above"]) == (40.0, 20.0, "the areoid")
    assert [one["profile"] for one in record["checks"]] == ["ap18933l", "ap19043l", "other"]
    assert [one["shift_adjusted"] for one in record["checks"]] == [True, True, False]
    assert "above the areoid" in capsys.readouterr().out
    assert not list(out.glob("*.png"))


def test_a_demo_s_case_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick(monkeypatch)
    demo = tmp_path / "demo"
    demo.mkdir()
    (demo / "solution.npz").write_bytes(dem_site.result().read_bytes())
    with pytest.raises(Exception, match="--case"):
        call("dem", demo, "--out", tmp_path / "dem")
    (demo / "inputs").symlink_to(dem_site.case_path().parent)
    assert call("dem", demo, "--out", tmp_path / "dem", "--no-figures") == 0


# ---- bad input


# above two seconds: a site is solved once for all tests of the file
def test_bad_input_writes_nothing(site: Path, tmp_path: Path, case_file: Path) -> None:
    result, foreign, renamed = site.parent / "result", tmp_path / "foreign", site.with_name("renamed.toml")
    foreign.mkdir()
    (foreign / "mine.txt").write_text("")
    renamed.write_text(site.read_text(encoding="utf-8").replace("E02-01453", "E02-99999"), encoding="utf-8")
    out = "--out", tmp_path / "dem"
    for said, arguments in {
        "no such file": (tmp_path / "none", "--case", site, *out),
        "none.toml: no such file": (result, "--case", tmp_path / "none.toml", *out),
        "post: -5.0 m; expected a positive number": (result, "--case", site, *out, "--post", "-5"),
        "none.b": (result, "--case", site, *out, "--shots", tmp_path / "none.b"),
        "give the case that was adjusted": (result, "--case", case_file, *out),  # another one
        "no such image": (result, "--case", site, *out, "--image", "E02-00665", "--image", "E1"),
        "two different images": (result, "--case", site, *out, "--image", "A"),
        "images that the solution doesn't have: E02-99999": (result, "--case", renamed, *out),
        "not a result of mgsgraph": (result, "--case", site, "--out", foreign),
        "name it by --case": (result / "solution.npz", *out),
        "mgsgraph adjust": (site.parent, "--case", site, *out),
    }.items():
        assert said in refusal("dem", *arguments)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["case", "foreign"]


# --- `mgsgraph adjust` with a terrain model as a person uses it


REFERENCE = 3_396_190.0
"""m."""


def add_terrain(case_file: Path, east: float = 0.0, missing: float = 0.0) -> None:
    """The simulated relief beside the case, as a GeoTIFF; so many degrees off, some share of its posts missing."""
    rasterio = pytest.importorskip("rasterio")
    grid = networks.terrain(networks.network(networks.pair(ties=20, shots=8)))
    rows, columns = grid.radii.shape
    step = grid.longitude_step / DEG
    radii = np.where(np.random.default_rng(1).random((rows, columns)) < missing, np.nan, grid.radii)
    west, north = grid.first_longitude / DEG - 0.5 * step + east, grid.first_latitude / DEG + 0.5 * step
    with rasterio.open(
        case_file.with_name("terrain.tif"), "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float64",
        crs=f"+proj=longlat +R={REFERENCE} +no_defs", transform=rasterio.Affine(step, 0, west, 0, -step, north),
    ) as file:
        file.write(radii - REFERENCE, 1)
    with case_file.open("a", encoding="utf-8") as file:
        file.write(f'\n[terrain]\nradius = "terrain.tif"\nreference_radius_m = {REFERENCE}\n')


def test_two_steps_are_two_calls(case_file: Path, tmp_path: Path) -> None:
    """As docs/terrain.md has them: of the case without its terrain model as control, and of the case."""
    add_terrain(case_file)
    free = case_file.with_name("free.toml")
    text = case_file.read_text(encoding="utf-8")
    free.write_text(text.replace("[terrain]", "[terrain]\ncontrol = false"), encoding="utf-8")
    for path, rows in ((free, False), (case_file, True)):
        out = tmp_path / f"{path.stem}-out"
        assert call("adjust", path, "--reject", 4, "--no-figures", "--out", out) == 0
        solution = read_solution(out)
        assert (solution.network.surface is not None) == rows
        assert solution.rays_rejected is not None


@pytest.mark.parametrize(
    ("east", "missing", "ties", "said"),
    [(30.0, 0.0, True, ""), (0.0, 2.0, True, ""), (0.0, 0.0, False, "a case without tie points")],
)
def test_terrain_without_points_is_told_in_a_line(
    case_file: Path, tmp_path: Path, east: float, missing: float, ties: bool, said: str
) -> None:
    add_terrain(case_file, east, missing)
    if not ties:
        case_file.write_text(re.sub(r"\[ties\][^\[]*", "", case_file.read_text(encoding="utf-8")), encoding="utf-8")
    assert said in refusal("adjust", case_file, "--no-figures", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


# --- `mgsgraph footprints` as a person uses it: files, sentences, exit status, and nothing left over after b


@pytest.mark.slow
def test_before_and_after_an_adjustment(case_file: Path, tmp_path: Path) -> None:
    mola_case = profiles.with_profile(case_file)
    result, out = tmp_path / "result", tmp_path / "registration"
    assert run("adjust", mola_case, "--out", result, "--no-figures").returncode == 0
    done = run("footprints", result, "--case", mola_case, "--out", out)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    record = json.loads((out / "registration.json").read_text(encoding="utf-8"))
    assert set(record["orientations"]) == {"nominal", "adjusted"}
    assert [line[2:] for line in done.stdout.splitlines() if line.startswith("- ")] == record["statements"]
    assert {path.suffix for path in out.iterdir()} == {".json", ".csv", ".png"}
    assert "fall in SIM/A" in done.stdout

    again = run("footprints", mola_case, "--out", out, "--no-figures")  # an earlier registration is replaced
    assert again.returncode == 0, again.stderr
    assert {path.suffix for path in out.iterdir()} == {".json", ".csv"}
    assert "adjusted" not in again.stdout

    names = sorted(path.name for path in result.iterdir())  # a solution isn't
    refused(run("footprints", result, "--out", result), "solution.json", result, names)
    names = sorted(path.name for path in out.iterdir())  # nor a registration by an adjustment
    refused(run("adjust", mola_case, "--out", out), "registration.json", out, names)


def test_what_cannot_be_registered_writes_nothing(case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "registration"
    assert "no such file" in refusal("footprints", tmp_path / "none.toml", "--out", out)
    assert "solution.npz" in refusal("footprints", tmp_path, "--case", case_file, "--out", out)
    assert "no laser profile" in refusal("footprints", case_file, "--out", out)
    assert not out.exists()


# --- `mgsgraph footprints FILES` as a person uses it: a profile found, written, and taken by the case in place of the


def test_a_selection_takes_the_archives_place_in_a_case(case_file: Path, tmp_path: Path) -> None:
    case = profiles.with_profile(case_file)
    found = tmp_path / "found.csv"
    done = run("footprints", case, case.with_name("profile.csv"), "--image", "SIM/A", "--along", "--out", found)
    assert done.returncode == 0, done.stderr
    assert "18933 taken along" in done.stdout

    assert SELECTION.known(found)
    mine = tmp_path / "mine.csv"
    mine.write_text("years,of,work\n", encoding="utf-8")
    shots, out = case.with_name("profile.csv"), tmp_path / "out.csv"
    for said, arguments in {
        "mine.csv: exists and is not a selection of mgsgraph footprints": (case, shots, "--out", mine),
        "no such file": (case, tmp_path / "none.csv", "--out", out),
        "SIM/Z: no such image": (case, shots, "--image", "SIM/Z", "--out", out),
        "dates": (case, shots, "--dates", "1999-13-01", "1999-02-01", "--out", out),
        "--ties and --no-figures go without FILES": (case, shots, "--ties", out),
        "go with FILES": (case, "--margin", 2),
    }.items():
        assert said in refusal("footprints", *arguments)
    assert mine.read_text(encoding="utf-8") == "years,of,work\n"
    assert not out.exists()

    before = mgsgraph.read_case(case).network
    case.write_text(case.read_text(encoding="utf-8").replace('"profile.csv"', f'"{found}"'), encoding="utf-8")
    after = mgsgraph.read_case(case).network
    assert after.ranges.values.tolist() == before.ranges.values.tolist()
    assert after.ranges.times.tolist() == before.ranges.times.tolist()

    nothing = tmp_path / "nothing.csv"
    done = run("footprints", case, found, "--dates", "1999-01-01", "1999-01-02", "--out", nothing)
    assert done.returncode == 0
    assert not nothing.exists()


@pytest.mark.parametrize("kind", ["result", "project"])
def test_results_and_projects_show_their_shots_as_adjusted(
    kind: str, case_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The profile was simulated along sample 500 of the true image A: as adjusted it falls nearer there than by the
    nominal orientation. An image is called by a part of its name that no other has.
    """
    profile, source = tmp_path / "profile.csv", tmp_path / kind
    profiles.write_profile(profile)
    if kind == "result":
        call("adjust", case_file, "--out", source, "--no-figures")
    else:
        call("project", "init", source, "--case", case_file)
        refuses("without a batch solution", call, "footprints", source, profile)
        call("project", "solve", source, "--no-figures")
    capsys.readouterr()
    call("footprints", source, profile, "--image", "/A", "--along", "--out", tmp_path / "found.csv")
    assert f"SIM/A: {profiles.SHOTS} shots of 1 profile fall in it, 18933 taken along" in capsys.readouterr().out
    refuses("SIM: a part of 2 names", call, "footprints", source, profile, "--image", "SIM")

    shots = read_shots(tmp_path / "found.csv")
    off = []
    for path in (source, case_file):
        (view,) = oriented_images(path, ("SIM/A",)).views
        samples = view.image.ground_to_image(shots.footprints, view.correction)[0][:, 1]
        off.append(float(np.abs(samples - 500.0).mean()))
    assert off[0] < 0.5 * off[1]


def test_noise_is_left_out_unless_it_is_asked_for(case_file: Path, tmp_path: Path) -> None:
    case, found = profiles.with_profile(case_file), tmp_path / "found.csv"
    call("footprints", case, case.with_name("profile.csv"), "--out", found)
    rows = rows_of(found)
    for row in rows[:7]:
        row["ground"] = "0"
    with (tmp_path / "noisy.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    sizes = []
    for k, more in enumerate([(), ("--quality", "all")]):
        call("footprints", case, tmp_path / "noisy.csv", *more, "--out", tmp_path / f"{k}.csv")
        sizes.append(read_shots(tmp_path / f"{k}.csv").times.size)
    assert sizes == [len(rows) - 7, len(rows)]
