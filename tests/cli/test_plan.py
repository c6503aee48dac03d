"""`mgsgraph plan` and `nodes` as a person uses them: candidates, spacings, a table, files, one line for errors."""

import json
import re
from pathlib import Path

import pytest
from commands import call, refusal, rows_of
from increments import NOISE, strip

from mgsgraph.geometry.body import geodetic
from mgsgraph.planning.candidates_file import decode_candidates
from mgsgraph.results.archive import read_solution
from mgsgraph.simulation.case_files import image_file, json_text, support_data
from mgsgraph.simulation.files import write_strip, write_texts
from mgsgraph.units import DEG, MRAD

ORIENTATION = (
    f"[orientation]\nposition_sigma_m = {float(NOISE.position)!r}\nangle_sigma_mrad = {float(NOISE.angle / MRAD)!r}\n"
    f"trend = {[float(factor) for factor in NOISE.trend]}\n"
)
_THERE, _ALL = 4, 6


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a case of four images, its results, and the support data of two images more."""
    folder, made = tmp_path_factory.mktemp("plan"), strip(_ALL)
    write_strip(made.upto(_THERE), folder)
    write_texts(folder, {image_file(one): json_text(support_data(one)) for one in made.images[_THERE:]})
    assert call("adjust", folder / "case.toml", "--out", folder / "results", "--no-figures") == 0
    return folder


def image(k: int, more: str = "") -> str:
    one = strip(_ALL).images[k]
    return f'[[images]]\nname = "{one.name}"\nisd = "{image_file(one)}"\n{more}\n'


TRACK = f"""
[[profiles]]
name = "along"
image = "{strip(_ALL).images[0].name}"
every_s = 0.5
ground_sigma_m = 5.0
range_sigma_m = 2.0
shift_sigma_m = 20.0
image_sigma_px = 5.0
"""


def control(adjusted: Path) -> str:
    solution = read_solution(adjusted / "results")
    place = geodetic(solution.places[:1], solution.network.body)[0]
    longitude, latitude, height = (place / [DEG, DEG, 1.0]).tolist()
    return (
        f'[[control]]\nname = "hill"\nlongitude_deg = {longitude}\nlatitude_deg = {latitude}\n'
        f"height_m = {height}\nsigma_m = [1.0, 1.0, 3.0]\nsigma_px = 0.5\n"
    )


def candidates(adjusted: Path, text: str) -> Path:
    path = adjusted / "candidates.toml"
    path.write_text(f"format = 1\n{ORIENTATION}\n{text}", encoding="utf-8")
    return path


def test_a_plan_on_the_terminal_and_in_files(
    adjusted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = image(4, "ties = 10\nexisting = true") + image(5, "ties = 12") + TRACK + control(adjusted)
    out = tmp_path / "plan"
    assert call("plan", adjusted / "results", candidates(adjusted, text), "--choose", "2", "--out", out, "-v") == 0
    assert "Chosen one after the other" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"plan.json", "plan.csv"}
    record = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert len(record["ranking"]) == 4
    assert [one["drop_percent"] for one in record["ranking"]] == sorted(
        (one["drop_percent"] for one in record["ranking"]), reverse=True
    )
    assert record["after_all_chosen"]["sigma_m"] < record["now"]["sigma_m"]
    assert record["bits_of_all_chosen"] == pytest.approx(sum(one["bits"] for one in record["chosen"]))
    rows = rows_of(out / "plan.csv")
    assert [row["candidate"] for row in rows if row["list"] == "chosen"] == [one["name"] for one in record["chosen"]]
    assert float(rows[0]["sigma_after_m"]) == record["ranking"][0]["after"]["sigma_m"]
    assert call("plan", adjusted / "results", candidates(adjusted, text), "--out", out) == 0  # its own is replaced
    kept = refusal("plan", adjusted / "results", candidates(adjusted, text), "--out", adjusted / "results")
    assert "another kind of result" in kept


def test_a_project_gives_the_plan_of_its_solution(adjusted: Path, tmp_path: Path) -> None:
    project, path = tmp_path / "project", candidates(adjusted, image(4, "ties = 10\nexisting = true"))
    call("project", "init", project, "--case", adjusted / "case.toml")
    assert "a project without a solution" in refusal("plan", project, path)
    assert call("project", "solve", project, "--no-figures") == 0
    found = []
    for where in (project, adjusted / "results"):
        out = tmp_path / f"plan of {where.name}"
        assert call("plan", where, path, "--criterion", "worst", "--out", out) == 0
        found.append(json.loads((out / "plan.json").read_text(encoding="utf-8"))["chosen"][0])
    for key in ("bits", "drop_percent", "image_measures"):
        assert found[0][key] == pytest.approx(found[1][key], rel=1e-4)


def test_targets_by_name(adjusted: Path, tmp_path: Path) -> None:
    point, name = read_solution(adjusted / "results").network.points.ids[0], strip(_ALL).images[3].name
    path = candidates(adjusted, image(4))
    assert call("plan", adjusted / "results", path, "--target", point, "--target", name, "--out", tmp_path / "p") == 0
    assert json.loads((tmp_path / "p" / "plan.json").read_text(encoding="utf-8"))["targets"] == [point, name]


def test_a_profile_from_a_file_of_shots(adjusted: Path, tmp_path: Path) -> None:
    """Shots that the network has already, given once more under another name, are worth something."""
    name = strip(_ALL).images[0].name
    text = f'[[profiles]]\nname = "again"\nfile = "lidar.json"\nimage = "{name}"\nground_sigma_m = 5.0\n'
    assert call("plan", adjusted / "results", candidates(adjusted, text), "--out", tmp_path / "p") == 0
    (one,) = json.loads((tmp_path / "p" / "plan.json").read_text(encoding="utf-8"))["ranking"]
    assert one["ranges"] == 5
    assert one["bits"] > 0.0


def test_shots_on_another_body_are_refused(adjusted: Path, tmp_path: Path) -> None:
    table = json.loads((adjusted / "lidar.json").read_text(encoding="utf-8"))
    for shot in table["points"]:
        shot["radius"] *= 1737.4 / 3396.19
    (tmp_path / "moon.json").write_text(json.dumps(table), encoding="utf-8")
    text = f'[[profiles]]\nname = "again"\nfile = "{tmp_path}/moon.json"\nground_sigma_m = 5.0\n'
    assert "moon.json: radii of 1,7" in refusal("plan", adjusted / "results", candidates(adjusted, text))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no candidate"),
        ("[[pictures]]\n", "unknown key 'pictures'"),
        (image(4, "tyes = 3"), "'tyes'"),
        (image(0), "which is in the network already"),
        (
            '[[control]]\nname = "c"\nlongitude_deg = 0.0\nlatitude_deg = 0.0\nradius_m = 3392.9\n',
            "3392.9 m from the body's centre",
        ),
        (image(4) + image(4), "two candidates named"),
        (image(4, "ties_per_cell = 1.0"), "unknown key 'ties_per_cell'"),
        ('[[profiles]]\nname = "p"\n', "neither file nor every_s"),
        ('[[profiles]]\nname = "p"\nimage = "X"\nevery_s = 1.0\n', "the image 'X'; expected an image of the network"),
        ('[[profiles]]\nname = "p"\nevery_s = 1.0\n', "every_s without image"),
        ('[[control]]\nname = "c"\nlongitude_deg = 0.0\nlatitude_deg = 0.0\n', "neither height_m nor radius_m"),
        (
            '[[control]]\nname = "c"\nlongitude_deg = 0.0\nlatitude_deg = 0.0\nheight_m = 0.0\nsigma_m = [1.0, 2.0]\n',
            "2 numbers; expected one, or three",
        ),
        ("[[control]]\nname = 3\n", "expected a text"),
        ("format = [", "malformed TOML"),
    ],
)
def test_bad_candidates_are_one_line(adjusted: Path, text: str, said: str) -> None:
    message = refusal("plan", adjusted / "results", candidates(adjusted, text))
    assert said in message
    assert "candidates.toml" in message


def test_bad_arguments_are_one_line(adjusted: Path, tmp_path: Path) -> None:
    path = candidates(adjusted, image(4))
    for said, arguments in {
        "no determined point: image nobody": (adjusted / "results", path, "--target", "nobody"),
        "a folder with neither": (tmp_path, path),
        "no such file": (adjusted / "nowhere", path),
        "no candidates.toml": (adjusted / "results", adjusted / "no candidates.toml"),
    }.items():
        assert said in refusal("plan", *arguments)


def test_the_example_of_the_docs_is_a_candidates_file(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "plan.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.+?)\n```", page, re.DOTALL)
    (tmp_path / "candidates.toml").write_text(example, encoding="utf-8")
    wanted = decode_candidates(tmp_path / "candidates.toml")
    assert (len(wanted.images), len(wanted.profiles), len(wanted.control)) == (1, 2, 1)


# --- `mgsgraph nodes` as a person uses it: a case with strips, a table, files, one line for errors


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six images, each a strip of its own."""
    folder, made = tmp_path_factory.mktemp("nodes"), strip(6)
    write_strip(made, folder)
    table = '\n[[passes]]\nname = "{0}"\nimages = ["{0}"]\nprior = {{}}\n'
    tables = "".join(table.format(one.name) for one in made.images)
    with (folder / "case.toml").open("a", encoding="utf-8") as file:
        file.write(tables)
    return folder / "case.toml"


@pytest.mark.slow
def test_table_sentences_and_files(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = case.parent / "out"
    arguments = ("analyze", case, "--nodes", "3,0.02,1.85", "--hold-out", "0.5", "--out", out)
    assert call(*arguments) == 0
    said = capsys.readouterr().out
    assert re.search(r"^ +0\.02 +\d+ +refused: pass 'STRIP/000N', nodes closer than the data supports", said, re.M)
    assert re.search(r"^ +(1\.85|3) .* chosen$", said, re.M)
    assert "rays held out" in said
    record = json.loads((out / "nodes.json").read_text(encoding="utf-8"))
    assert record["chosen_s"] in (1.85, 3.0)
    rows = rows_of(out / "spacings.csv")
    assert (rows[0]["spacing_s"], rows[0]["standing"]) == ("0.02", "refused")
    assert call(*arguments) == 0  # an earlier study is replaced


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--nodes", "four"), "'four'; expected positive numbers of seconds"),
        (("--nodes", "4,-1"), "positive numbers"),
        (("--nodes", "3"), "two or more that differ"),
        (("--nodes", "3,0.02", "--hold-out", "2"), "share of 2.0"),
        (("--nodes", "3,4", "--weak", "2"), "--nodes goes with"),
        (("--hold-out", "0.5"), "no --nodes"),
    ],
)
def test_bad_options_are_one_line(case: Path, options: tuple[str, ...], words: str) -> None:
    assert words in refusal("analyze", case, *options)


def test_what_is_not_studied(case: Path, tmp_path: Path) -> None:
    write_strip(strip(6).upto(2), tmp_path)
    assert "no passes" in refusal("analyze", tmp_path / "case.toml", "--nodes")
    assert "not a result" in refusal("analyze", case, "--nodes", "4,8", "--out", tmp_path)
