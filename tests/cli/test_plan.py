"""`mgsgraph plan` as a person uses it: a candidates file, results or a project, a table, files, one line for errors."""

import csv
import json
import re
from pathlib import Path

import pytest
from commands import call
from increments import NOISE, strip

from mgsgraph.errors import InputError
from mgsgraph.planning.candidates_file import decode_candidates
from mgsgraph.results.archive import read_solution
from mgsgraph.simulation.case_files import image_file, json_text, support_data
from mgsgraph.simulation.files import write_strip, write_texts
from mgsgraph.units import MRAD

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


def control(adjusted: Path, name: str = "hill", sigmas: str = "[1.0, 1.0, 3.0]") -> str:
    from mgsgraph.geometry.body import geodetic
    from mgsgraph.units import DEG

    solution = read_solution(adjusted / "results")
    place = geodetic(solution.places[:1], solution.network.images[0].body)[0]
    return (
        f'[[control]]\nname = "{name}"\nlongitude_deg = {place[0] / DEG!r}\nlatitude_deg = {place[1] / DEG!r}\n'
        f"height_m = {float(place[2])!r}\nsigma_m = {sigmas}\nsigma_px = 0.5\n"
    ).replace("np.float64(", "").replace(")", "")


def candidates(adjusted: Path, text: str) -> Path:
    path = adjusted / "candidates.toml"
    path.write_text(f"format = 1\n{ORIENTATION}\n{text}", encoding="utf-8")
    return path


def test_a_plan_on_the_terminal_and_in_files(
    adjusted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = image(4, "ties = 10\nexisting = true") + image(5, "ties = 12") + TRACK + control(adjusted)
    out = tmp_path / "plan"
    assert call("plan", adjusted / "results", candidates(adjusted, text), "--choose", "2", "--out", out) == 0
    said = capsys.readouterr().out
    for words in ("Each by itself", "Chosen one after the other", "bits", "control point", "mean sigma is"):
        assert words in said
    assert {path.name for path in out.iterdir()} == {"plan.json", "plan.csv"}
    record = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert len(record["ranking"]) == 4
    assert [one["drop_percent"] for one in record["ranking"]] == sorted(
        (one["drop_percent"] for one in record["ranking"]), reverse=True
    )
    assert record["after_all_chosen"]["sigma_m"] < record["now"]["sigma_m"]
    assert record["bits_of_all_chosen"] == pytest.approx(sum(one["bits"] for one in record["chosen"]))
    with (out / "plan.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["candidate"] for row in rows if row["list"] == "chosen"] == [one["name"] for one in record["chosen"]]
    assert float(rows[0]["sigma_after_m"]) == record["ranking"][0]["after"]["sigma_m"]
    assert call("plan", adjusted / "results", candidates(adjusted, text), "--out", out) == 0  # its own is replaced
    with pytest.raises(InputError, match="another kind of result"):
        call("plan", adjusted / "results", candidates(adjusted, text), "--out", adjusted / "results")


def test_a_project_gives_the_plan_of_its_solution(adjusted: Path, tmp_path: Path) -> None:
    project, path = tmp_path / "project", candidates(adjusted, image(4, "ties = 10\nexisting = true"))
    call("init", project, "--case", adjusted / "case.toml")
    with pytest.raises(InputError, match="a project without a solution"):
        call("plan", project, path)
    assert call("solve", project, "--no-figures") == 0
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
    with pytest.raises(InputError, match=r"moon\.json: radii of 1,7"):
        call("plan", adjusted / "results", candidates(adjusted, text))


def test_nothing_worth_anything_is_no_error(adjusted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = '[[control]]\nname = "far"\nlongitude_deg = 0.0\nlatitude_deg = 60.0\nradius_m = 3.39e6\n'
    assert call("plan", adjusted / "results", candidates(adjusted, text)) == 0
    said = capsys.readouterr().out
    assert "worthless: no image of the network shows it" in said
    assert "None of the candidates" in said


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no candidate"),
        ("[[pictures]]\n", "unknown key 'pictures'"),
        (image(4, "tyes = 3"), "images.*'tyes'.*'ties'"),
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
        ("[[control]]\nname = 3\n", "control.*expected a text"),
        ("format = [", "malformed TOML"),
    ],
)
def test_bad_candidates_are_one_line(adjusted: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        call("plan", adjusted / "results", candidates(adjusted, text))
    assert "\n" not in str(caught.value)
    assert "candidates.toml" in str(caught.value)


def test_bad_arguments_are_one_line(adjusted: Path, tmp_path: Path) -> None:
    path = candidates(adjusted, image(4))
    with pytest.raises(InputError, match="'nobody', which is no determined point"):
        call("plan", adjusted / "results", path, "--target", "nobody")
    with pytest.raises(InputError, match="a folder with neither"):
        call("plan", tmp_path, path)
    with pytest.raises(InputError, match="no such file"):
        call("plan", adjusted / "nowhere", path)
    with pytest.raises(InputError, match="candidates"):
        call("plan", adjusted / "results", adjusted / "no candidates.toml")


def test_the_example_of_the_docs_is_a_candidates_file(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "plan.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.+?)\n```", page, re.DOTALL)
    (tmp_path / "candidates.toml").write_text(example, encoding="utf-8")
    wanted = decode_candidates(tmp_path / "candidates.toml")
    assert (len(wanted.images), len(wanted.profiles), len(wanted.control)) == (1, 2, 1)
