"""Case files: what they say becomes a network; what is wrong in them is said in one line with its path."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from commands import refusal
from cubes import MAPPED, written
from msgspec import structs
from outside import refuses

import mgsgraph
from mgsgraph.case.assembly import merged
from mgsgraph.case.case_file import HEAD, decode, key_tables, keys_text, plain_image, read_image
from mgsgraph.case.reading import picture_of
from mgsgraph.case.schema import CaseInput, ImageInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.files.networks.binary import read_network
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.record import ControlPoint
from mgsgraph.files.networks.tie_points import PointKind, TiePoints
from mgsgraph.network import Network, PointClass
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import known_images
from mgsgraph.project.campaign import checksums
from mgsgraph.project.settings import settings_of_case
from mgsgraph.results.inventory import inventory
from mgsgraph.units import MRAD

Edit = Callable[[str], str]


def swap(old: str, new: str) -> Edit:
    def edit(text: str) -> str:
        assert old in text, f"{old!r} isn't in the case file"
        return text.replace(old, new, 1)

    return edit


def add(line: str) -> Edit:
    return lambda text: text + "\n" + line + "\n"


def edited(case_file: Path, *edits: Edit) -> Path:
    text = case_file.read_text(encoding="utf-8")
    for edit in edits:
        text = edit(text)
    case_file.write_text(text, encoding="utf-8")
    return case_file


def test_a_case_becomes_a_network(case_file: Path) -> None:
    case = mgsgraph.read_case(case_file)
    net = case.network
    assert net.image_names == ["SIM/A", "SIM/B"]
    assert len(net.points) == 28
    assert net.rays.point.size == 56
    assert net.ranges.point.size == 8
    assert np.all(net.rays.sigmas[net.points.classes[net.rays.point] == PointClass.TIE] == 1.0)
    assert np.all(net.rays.sigmas[net.points.classes[net.rays.point] == PointClass.LASER] == 5.0)
    np.testing.assert_allclose(net.priors[0].sigmas[:, 0], [30.0, 3.0, 0.3])
    np.testing.assert_allclose(net.priors[0].sigmas[:, 3], np.array([1.0, 0.1, 0.01]) * 0.1 * MRAD)
    assert "28 points" in repr(case)


def test_laser_false_leaves_the_laser_out(case_file: Path) -> None:
    with_rows = mgsgraph.read_case(case_file, laser=False).network
    text = re.sub(r"\[laser\][^\[]*", "", case_file.read_text(encoding="utf-8"))
    case_file.write_text(text.replace("format = 1", "format = 1\nlaser = false"), encoding="utf-8")
    net = mgsgraph.read_case(case_file).network
    assert net.ranges.point.size == with_rows.ranges.point.size == 0
    assert len(net.points) == len(with_rows.points) == 20


def test_settings_and_overrides(case_file: Path) -> None:
    case = mgsgraph.read_case(
        edited(
            case_file,
            swap(
                'isd = "image_B.isd"',
                'isd = "image_B.isd"\nheld = true\norientation = {degree = 1, '
                "position_sigma_m = [1.0, 2.0, inf], angle_sigma_mrad = 3, trend = [1, 0.5]}",
            ),
            add('[solver]\nloss = "huber"\nreject = 5\nline = "measured"'),
        )
    )
    assert case.network.held.tolist() == [False, True]
    assert case.network.priors[1].sigmas[0].tolist() == [1.0, 2.0, np.inf, 0.003, 0.003, 0.003]
    assert case.network.priors[1].degree == 1
    assert (case.settings.loss, case.settings.reject, case.settings.line) == ("huber", 5.0, "measured")


@pytest.mark.parametrize("nominal", ["polynomial", "attitude polynomial"])
def test_the_nominal_orientation_is_the_one_that_is_said(case_file: Path, nominal: str) -> None:
    """jigsaw's polynomials leave the positions alone, the papers' do not."""
    lines = np.linspace(10.0, 50.0, 5)
    before = mgsgraph.read_case(case_file).network.images[0].pose(lines)
    case = mgsgraph.read_case(edited(case_file, swap("[orientation]", f'[orientation]\nnominal = "{nominal}"')))
    after = case.network.images[0].pose(lines)
    assert np.array_equal(before.position, after.position) is (nominal == "attitude polynomial")
    assert 0.0 < np.abs(before.matrix - after.matrix).max() < 1e-4


def test_files_own_sigmas_where_the_case_is_silent(case_file: Path) -> None:
    case = mgsgraph.read_case(edited(case_file, lambda text: re.sub(r"(range|ground)_sigma_m = .*\n", "", text)))
    assert np.all(case.network.ranges.sigmas == 1.0)
    laser = case.network.points.classes == PointClass.LASER
    np.testing.assert_allclose(
        case.network.points.covariances[laser], np.eye(3) * 100.0 * np.ones((8, 1, 1)), atol=1e-6
    )


def test_ground_control_joins_in(case_file: Path) -> None:
    case_file.with_name("points.gcp").write_text(
        "G1 4.0 87.0 10.0 1 1 1 SIM/A 100 200 1 1 SIM/B 150 220 1 1\n", encoding="utf-8"
    )
    net = mgsgraph.read_case(edited(case_file, add('[ground_control]\nfile = "points.gcp"'))).network
    control = np.flatnonzero(net.points.classes == PointClass.CONTROL)
    assert [net.points.ids[i] for i in control] == ["G1"]
    assert net.points.kinds[control] == [PointKind.CONSTRAINED]
    assert net.rays.places[net.rays.point == control[0]].tolist() == [[200.5, 100.5], [220.5, 150.5]]


TWO_GROUPS = '[[ties]]\nnetwork = "network.pvl"\n\n[[ties]]'
WRONG: dict[str, tuple[tuple[Edit, ...], str]] = {
    "no format": ((swap("format = 1", ""),), r"no key 'format'.*format = 1"),
    "malformed": ((add("= 3"),), r"malformed TOML.*line"),
    "sigma of the second group": (
        (swap("[ties]", TWO_GROUPS), swap("sigma_px = 1.0", "sigma_px = 0")), r"ties\[1\].sigma_px"
    ),
    "the same network twice": ((swap("[ties]", TWO_GROUPS),), r"a measure that .*network.pvl has too"),
    "negative sigma": ((swap("sigma_px = 1.0", "sigma_px = -1.0"),), r"ties.sigma_px: -1.0;.*>= 1e-06"),
    "two orientation sigmas": ((swap("position_sigma_m = 30.0", "position_sigma_m = [1, 2]"),), r"position_sigma_m"),
    "nan in a list": ((swap("trend = [1.0", "trend = [nan"),), r"trend"),
    "no images": ((lambda text: re.sub(r"\[\[images\]\][^\[]*", "", text),), r"images"),
    "missing ISD": ((swap("image_A.isd", "image_C.isd"),), r"image_C.isd: no such file"),
    "unknown image in the network": ((swap('name = "SIM/B"', 'name = "SIM/C"'),), r"measured in SIM/B, .*SIM/A, SIM/C"),
    "image twice": ((swap('name = "SIM/B"', 'name = "SIM/A"'),), r"images: the name 'SIM/A' for .*A.isd and.*B.isd"),
    "short trend": ((swap("trend = [1.0, 0.1, 0.01]", "trend = [1.0, 0.1]"),), r"orientation, trend: 2 factors.* 3, "),
    "no observations": ((lambda text: re.sub(r"\[(ties|laser)\][^\[]*", "", text),), r"at least one of them"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_wrong_is_said_in_one_line(case_file: Path, fault: str) -> None:
    edits, said = WRONG[fault]
    with pytest.raises(InputError, match=said) as caught:
        mgsgraph.read_case(edited(case_file, *edits))
    assert "\n" not in str(caught.value)


def test_a_measure_off_its_image(case_file: Path) -> None:
    network = case_file.with_name("network.pvl")
    text = re.sub(r"(\n\s*Line\s*=\s*)[\d.]+", r"\g<1>999999.0", network.read_text(encoding="utf-8"), count=1)
    network.write_text(text, encoding="utf-8")
    refuses(r"line 999999.*a place inside", mgsgraph.read_case, case_file)


def test_a_shot_outside_the_tables(case_file: Path) -> None:
    lidar = case_file.with_name("lidar.json")
    text = lidar.read_text(encoding="utf-8")
    time = re.search(r'"time": (-?[\d.]+)', text)
    assert time
    lidar.write_text(text.replace(time[1], str(float(time[1]) + 1000.0), 1), encoding="utf-8")
    refuses(r"lidar\.json, laser shot .*image SIM/A: time .* outside the tables", mgsgraph.read_case, case_file)


# --- groups


def split_network(case_file: Path, share: Callable[[int, str], tuple[bool, bool]]) -> Path:
    """The case's network as two files, a.pvl and b.pvl; `share` says of a measure (point's number, image) which get it.

    Sigmas go, so that the case's ones count. The case becomes one of two groups of ties.
    """
    text = case_file.with_name("network.pvl").read_text(encoding="utf-8")
    text = re.sub(r"\n\s*(Line|Sample)Sigma\s*=.*", "", text)
    head, *blocks = re.split(r"(?=\n +Object = ControlPoint\n)", text)
    tail = blocks[-1][re.search(r"End_Object(?=\s*End_Object)", blocks[-1]).end() :]  # type: ignore[union-attr]
    blocks[-1] = blocks[-1].removesuffix(tail)
    for which, name in enumerate(("a.pvl", "b.pvl")):
        kept = []
        for i, block in enumerate(blocks):
            def chosen(match: re.Match[str], i: int = i, which: int = which) -> str:
                image = re.search(r"SerialNumber\s*=\s*\"?([^\s\"]+)", match[0])
                assert image
                return match[0] if share(i, image[1])[which] else ""

            block = re.sub(r"\n\s*Group = ControlMeasure.*?End_Group", chosen, block, flags=re.DOTALL)
            kept += [block] if "ControlMeasure" in block else []
        case_file.with_name(name).write_text(head + "".join(kept) + tail, encoding="utf-8")
    groups = '[[ties]]\nnetwork = "a.pvl"\nsigma_px = 0.5\n\n[[ties]]\nnetwork = "b.pvl"\nsigma_px = 2.0\n\n'
    return edited(case_file, lambda text: re.sub(r"\[ties\][^\[]*", groups, text))


def same(net: Network, other: Network) -> None:
    """The same points and rays, whatever their order."""
    for one in (net, other):
        assert len(set(one.points.ids)) == len(one.points)
    rows = [
        sorted(
            (one.points.ids[i], int(j), *place)
            for i, j, place in zip(one.rays.point, one.rays.image, one.rays.places.tolist(), strict=True)
        )
        for one in (net, other)
    ]
    assert rows[0] == rows[1]
    assert sorted(net.points.ids) == sorted(other.points.ids)


@pytest.mark.parametrize("rule", ["by point", "by image"])
def test_two_networks_are_one_with_two_sigmas(case_file: Path, rule: str) -> None:
    """Points shared out between two files, or each point's measures: in both cases the points of the one file."""
    whole = mgsgraph.read_case(case_file).network

    def share(i: int, image: str) -> tuple[bool, bool]:
        first = i < 5 if rule == "by point" else image == "SIM/A"
        return first, not first

    case = mgsgraph.read_case(split_network(case_file, share))
    net = case.network
    same(net, whole)
    tie = net.points.classes[net.rays.point] == PointClass.TIE
    number = {name: i for i, name in enumerate(whole.points.ids)}
    for k in np.flatnonzero(tie):
        image = net.images[net.rays.image[k]].name
        first, _ = share(number[net.points.ids[net.rays.point[k]]], image)
        assert net.rays.sigmas[k].tolist() == ([0.5, 0.5] if first else [2.0, 2.0])
    assert case.ties is not None
    assert len(case.ties.ids) == 20
    assert "a.pvl" in case.ties.source
    assert "b.pvl" in case.ties.source


def test_an_image_has_its_own_sigma(case_file: Path) -> None:
    path = split_network(case_file, lambda i, _: (i < 5, i >= 5))
    edited(path, swap('isd = "image_B.isd"', 'isd = "image_B.isd"\nmeasure_sigma_px = 7.0'))
    net = mgsgraph.read_case(path).network
    tie = net.points.classes[net.rays.point] == PointClass.TIE
    second = net.rays.image == 1
    assert set(net.rays.sigmas[tie & second].ravel()) == {7.0}
    assert set(net.rays.sigmas[tie & ~second].ravel()) == {0.5, 2.0}
    assert set(net.rays.sigmas[~tie].ravel()) == {5.0}  # the shots' own


def test_a_factor_multiplies_whatever_sigmas_ties_have(case_file: Path) -> None:
    """The network's own, which sigma_px leaves alone; those of other rays stay."""
    before = mgsgraph.read_case(case_file).network
    after = mgsgraph.read_case(edited(case_file, swap("sigma_px = 1.0", "sigma_px = 9.0\nsigma_factor = 1.25"))).network
    tie = before.points.classes[before.rays.point] == PointClass.TIE
    np.testing.assert_allclose(after.rays.sigmas, before.rays.sigmas * np.where(tie, 1.25, 1.0)[:, None])
    assert settings_of_case(case_file).measures.tie_sigma_factor == 1.25


def test_a_measure_in_two_networks(case_file: Path) -> None:
    path = split_network(case_file, lambda i, _: (i < 5, i >= 4))
    refuses(r"b\.pvl, point .*, image SIM/A: a measure that .*a\.pvl has too", mgsgraph.read_case, path)


def test_measures_in_other_images_are_left_out_and_counted(case_file: Path) -> None:
    """A third image sees every point, but the last, which it alone sees with SIM/A: that one goes altogether."""
    whole = mgsgraph.read_case(case_file).network
    path = case_file.with_name("network.pvl")
    network = read_network(path)

    def third(i: int, point: ControlPoint) -> ControlPoint:
        seen = point.measures[:1] if i == len(network.points) - 1 else point.measures
        return structs.replace(point, measures=(*seen, structs.replace(seen[0], serial_number="SIM/X")))

    points = tuple(third(i, point) for i, point in enumerate(network.points))
    write_pvl_network(structs.replace(network, points=points), path)
    case = mgsgraph.read_case(case_file)

    assert case.ties is not None
    assert case.ties.ids == tuple(point.id for point in points[:-1])
    assert case.network.rays.point.size == whole.rays.point.size - 2
    (note,) = case.notes
    assert re.findall(r"\d+ \w+", note.replace(str(path), "")) == ["20 measures", "1 image", "1 point", "1 more"]
    assert "SIM/X" in note
    assert f"Warning: {note[:-1]}\n" in inventory(case, details=False)
    assert note[:-1] in inventory(case)
    edited(case_file, lambda text: re.sub(r"\[laser\][^\[]*", "", text), swap('"SIM/B"', '"SIM/C"'))
    refuses(r"network\.pvl: .*measured in SIM/B, .*; expected .*SIM/A, SIM/C", mgsgraph.read_case, case_file)


def test_a_network_of_another_body_is_refused(case_file: Path) -> None:
    path = case_file.with_name("network.pvl")
    for target in ("Moon", "Phobos"):
        write_pvl_network(structs.replace(read_network(path), target_name=target), path)
        refuses(rf"network\.pvl, TargetName: the target body {target}; expected MARS", mgsgraph.read_case, case_file)
    write_pvl_network(structs.replace(read_network(path), target_name="Mars"), path)
    assert mgsgraph.read_case(case_file).networks == (path,)


@pytest.mark.parametrize(
    ("shots", "key", "factor", "said"),
    [
        (slice(None), "range", 1e3, "ranges of .*metres stand where the format has kilometres"),
        (slice(None), "range", 1e-3, "ranges.*kilometres stand where"),
        (slice(None), "radius", 1e3, "radii.*metres stand where"),
        (slice(None), "sigmaRange", 1e-3, r"a sigma of 0\.001 m; .*are sigmas in kilometres"),
        (slice(3, 4), "range", 1e3, r"shot \S+: a range of .*metres stand where the format has kilometres"),
        (slice(3, 4), "radius", 1.2, r"m from the body's centre"),
        (slice(3, 4), "sigmaRange", 1e7, "a sigma of 1e[+]07 m"),
    ],
)
def test_lidar_data_in_other_units(case_file: Path, shots: slice, key: str, factor: float, said: str) -> None:
    """All of them, or one that no median shows; in a case and in a project."""
    path = case_file.with_name("lidar.json")
    table = json.loads(path.read_text(encoding="utf-8"))
    for shot in table["points"][shots]:
        shot[key] *= factor
    path.write_text(json.dumps(table), encoding="utf-8")
    edited(case_file, lambda text: text.replace("range_sigma_m", "# range_sigma_m"))
    refuses(said, mgsgraph.read_case, case_file)
    images = {one.image.name: one for one in known_images(mgsgraph.read_case(case_file, laser=False).network)}
    if key != "radius":  # whose body the project knows, not this function
        refuses(said, build_network, images, [read_lidar(path)])


def test_two_groups_of_shots(case_file: Path) -> None:
    """One lidar file as two, the second half with other sigmas; `--no-laser` leaves out both."""
    table = json.loads(case_file.with_name("lidar.json").read_text(encoding="utf-8"))
    groups = ""
    for name, part, sigma in (("one.json", slice(0, 3), 4.0), ("two.json", slice(3, None), 9.0)):
        text = json.dumps({"points": table["points"][part]})
        case_file.with_name(name).write_text(text, encoding="utf-8")
        groups += f'[[laser]]\nfile = "{name}"\nimage_sigma_px = {sigma}\nrange_sigma_m = {10.0 * sigma}\n\n'
    whole = mgsgraph.read_case(case_file).network
    path = edited(case_file, lambda text: re.sub(r"\[laser\][^\[]*", groups, text))
    net = mgsgraph.read_case(path).network
    same(net, whole)
    np.testing.assert_array_equal(net.ranges.sigmas, [40.0] * 3 + [90.0] * 5)
    laser = net.points.classes[net.rays.point] == PointClass.LASER
    assert set(net.rays.sigmas[laser].ravel()) == {4.0, 9.0}
    assert mgsgraph.read_case(path, laser=False).network.ranges.point.size == 0
    assert {"one.json", "two.json", "network.pvl"} <= set(checksums(path))


def tie_points(source: str, kind: PointKind, place: float, sigma: float = 1.0, image: str = "I") -> TiePoints:
    free = kind == PointKind.FREE
    one = np.ones((1, 2))
    covariance = np.zeros((1, 3, 3)) if free else sigma**2 * np.eye(3)[None]
    return TiePoints(
        source, ("P",), np.array([kind]), np.array([[place, 0.0, 0.0]]), covariance, np.array([0]), (image,), one, one
    )


def test_what_two_networks_know_of_a_point() -> None:
    """The one that knows its place counts; two that contradict each other are refused."""
    guess, known = tie_points("a", PointKind.FREE, 5.0), tie_points("b", PointKind.CONSTRAINED, 7.0, image="J")
    nothing = tie_points("a", PointKind.FREE, np.nan)
    for groups in ([guess, known], [known, guess], [nothing, known]):
        one = merged(groups)
        assert (one.kinds.tolist(), one.places[0, 0], len(one.measure_image)) == ([PointKind.CONSTRAINED], 7.0, 2)
    assert merged([nothing, replace(guess, measure_image=("J",))]).places[0, 0] == 5.0
    for other in (tie_points("c", PointKind.CONSTRAINED, 7.1), tie_points("c", PointKind.FIXED, 7.0),
                  tie_points("c", PointKind.CONSTRAINED, 7.0, sigma=2.0)):  # fmt: skip
        refuses(r"c, point P: .*expected what b says of it", merged, [known, other])


def test_measures_within_one_window_have_errors_in_common(case_file: Path) -> None:
    """By the window that the case states, or that of the matching whose record lies beside the network."""
    whole = case_file.read_text(encoding="utf-8")

    def read(more: str = "") -> Network:
        case_file.write_text(whole.replace("[ties]\n", f"[ties]\n{more}\n"), encoding="utf-8")
        return mgsgraph.read_case(case_file).network

    def sigmas(more: str = "") -> np.ndarray:
        return read(more).rays.sigmas

    plain, network = sigmas(), read("window_px = 1e6")
    assert network.common_rays is not None
    wide, ties = network.rays.sigmas, network.common_rays.members
    assert np.all(network.points.classes[network.rays.point[ties]] == PointClass.TIE)
    np.testing.assert_allclose(network.ray_sigmas, plain)
    images = np.bincount(network.rays.image[ties])
    larger = plain[ties] * np.sqrt(images[network.rays.image[ties]])[:, None]
    assert network.independent.rays.sigmas[ties] == pytest.approx(larger, rel=0.02)
    shared = sigmas("window_px = 1e6\ncommon_share = 0.5")[ties] / plain[ties]
    np.testing.assert_allclose(shared, np.sqrt(0.5), rtol=0.01)
    record = case_file.with_name("match.json")
    record.write_text('{"settings": {"half_window": 499999.5}}', encoding="utf-8")
    np.testing.assert_array_equal(sigmas(), wide)
    np.testing.assert_array_equal(sigmas("window_px = 0"), plain)
    record.write_text("{}", encoding="utf-8")
    refuses("half_window", sigmas)


# --- keys of a case file as they are told: every one that the schema takes, with a meaning; and lines of w


TABLES = {table.path or HEAD: table for table in key_tables()}


def test_every_key_is_there_with_a_meaning_and_a_kind() -> None:
    assert {"head", "images", "orientation", "ties", "spice", "solver", "terrain", "passes.nodes"} <= set(TABLES)
    for kind, name in ((CaseInput, HEAD), (ImageInput, "images")):
        assert [key.name for key in TABLES[name].keys] == [field.name for field in msgspec.structs.fields(kind)]
    for table in TABLES.values():
        assert table.meaning
        for key in table.keys:
            assert key.meaning, f"{table.head} {key.name}"
            assert re.fullmatch(r"[a-z\d\"][\w ,\"+/-]*", key.kind), f"{table.head} {key.name}: {key.kind}"
    (kernels,) = [key for key in TABLES["images"].keys if key.name == "kernels"]
    assert kernels.kind == "list of texts"
    (loss,) = [key for key in TABLES["solver"].keys if key.name == "loss"]
    assert (loss.kind, loss.default) == ('"none", "huber", "cauchy", "tukey"', '"none"')


@pytest.mark.parametrize(("name", "near"), [("imags", "images"), ("nodes", "passes.nodes"), ("sulver", "solver")])
def test_a_table_that_there_is_not_names_the_nearest(name: str, near: str) -> None:
    refuses(f"did you mean {near}", keys_text, name)


WRONG_KEYS = {
    "in a table of several": ('isd = "image_B', 'isdd = "image_B', r"images\[1\] .*'isdd'; did you mean 'isd'"),
    "in an inline table": ("trend = [", "sub = {a = 1}\ntrend = [", "orientation: .*'sub'"),
    "of another table": ('isd = "image_B', 'sigma_px = 1.0\nisd = "image_B', r"images\[1\] .*it is a key of \[ties\]"),
    "of the wrong kind": ("degree = 2", 'degree = "two"', "orientation.degree: 'two'"),
    "missing": ('network = "network.pvl"\n', "", "ties: no key 'network'"),
}


@pytest.mark.parametrize("fault", WRONG_KEYS)
def test_what_is_wrong_is_named_with_its_line(case_file: Path, fault: str) -> None:
    old, new, said = WRONG_KEYS[fault]
    text = case_file.read_text(encoding="utf-8")
    assert old in text
    case_file.write_text(text.replace(old, new), encoding="utf-8")
    at = text[: text.index(old)].count("\n") + 1
    line = at - 1 if fault == "missing" else at
    refuses(rf"case.toml, line {line}, {said}", mgsgraph.read_case, case_file)


def test_data_in_the_place_of_a_case_file_say_how_to_come_by_one(case_file: Path) -> None:
    for data in (case_file.with_name("image_A.isd"), case_file.with_name("network.pvl"), case_file.parent):
        refuses(f"make one: mgsgraph new {data}", mgsgraph.read_case, data)


# --- images of a case by files that say themselves what they are, and ISIS lists of them


OTHER_CLOCK = ("100:0", "200:0")


def case_of_images(folder: Path, *images: str) -> Path:
    path = folder / "case.toml"
    tables = "".join(f"[[images]]\n{image}\n" for image in images)
    path.write_text(f'format = 1\nname = "cubes"\n{tables}')
    return path


def test_a_list_is_its_files_called_by_their_serial_numbers(tmp_path: Path) -> None:
    (tmp_path / "cubes").mkdir()
    written(tmp_path / "cubes", name="a.cub")
    written(tmp_path / "cubes", OTHER_CLOCK, name="b.cub")
    (tmp_path / "cubes" / "cubes.lis").write_text("a.cub\n\n# the second\nb.cub   # last\n")
    wanted = decode(case_of_images(tmp_path, 'list = "cubes/cubes.lis"\nheld = true'))
    assert [(image.name, image.cube, image.held) for image in wanted.images] == [
        ("MGS/100:0/MOC-NA", "cubes/a.cub", True), ("MGS/200:0/MOC-NA", "cubes/b.cub", True),
    ]  # fmt: skip
    image = read_image(wanted.images[1], None, tmp_path, "case")
    assert (image.name, image.lines) == ("MGS/200:0/MOC-NA", 100)


def test_kernels_of_an_image_go_before_its_tables(tmp_path: Path) -> None:
    """Those for all images don't: a cube with tables is whole."""
    written(tmp_path)
    for kernels, spice, kind in (((), None, "cube"), (("a.bsp",), None, "label"), ((), SpiceInput(("a.bsp",)), "cube")):
        entry = plain_image(ImageInput(image="image.cub", kernels=kernels), spice, tmp_path, "case")
        assert [key for key in ("isd", "cube", "label") if getattr(entry, key)] == [kind]


def test_a_cube_without_spice_needs_kernels(tmp_path: Path) -> None:
    written(tmp_path, ("Name = InstrumentPointing", "Name = Other"))
    entry = plain_image(ImageInput(image="image.cub"), SpiceInput(("a.bsp",)), tmp_path, "case")
    assert entry.label == "image.cub"
    entry = plain_image(ImageInput(image="image.cub"), None, tmp_path, "case")
    with pytest.raises(InputError, match=r"run spiceinit on the cube .*, or name the label and its kernels"):
        read_image(entry, None, tmp_path, "case")


def test_pixels_are_the_cubes_own_unless_it_is_a_map(tmp_path: Path) -> None:
    assert picture_of(ImageInput(cube="image.cub"), written(tmp_path).parent) == tmp_path / "image.cub"
    assert picture_of(ImageInput(cube="image.cub"), written(tmp_path, MAPPED).parent) is None


FAULTS = {
    "nothing": (("held = true",), "images[0]: no file of the image; expected one of image, list, isd, state, label"),
    "an empty list": (('list = "empty.lis"',), "empty.lis: no file; expected the name of an image file in every line"),
    "gone": (('list = "gone.lis"',), "gone.lis, line 2: 'c.cub', which is not there"),
    "no image": (('image = "gone.lis"',), "gone.lis: an ISIS list of files"),
    "of ASP": (('name = "A"\nisd = "run-a.adjust"',), "run-a.adjust: an adjustment of ASP's bundle_adjust; "),
    "PDS4": (('name = "A"\nlabel = "a.xml"\nkernels = ["a.bsp"]',), "a.xml: a PDS4 label; "),
    "twice": (('image = "image.cub"', 'name = "MGS/100:0/MOC-NA"\nisd = "a.isd"'), "for image.cub and for a.isd"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_said_in_one_line(tmp_path: Path, fault: str) -> None:
    written(tmp_path)
    (tmp_path / "empty.lis").write_text("# nothing\n")
    (tmp_path / "gone.lis").write_text("image.cub\nc.cub\n")
    (tmp_path / "run-a.adjust").write_text("0 0 0\n1 0 0 0\n")
    (tmp_path / "a.xml").write_text("<Product_Observational/>")
    images, said = FAULTS[fault]
    path = case_of_images(tmp_path, *images)
    message = refusal("check", path)
    assert said in message
    assert str(tmp_path) in message


@pytest.mark.parametrize(
    "key", ["attitude_bias_s = 5.0", "focal_length_m = 1.0", 'constants = "ik"', 'line_times = "mean"']
)
def test_keys_that_would_change_nothing_are_refused(tmp_path: Path, key: str) -> None:
    """A cube has its own constants and times: a case that says others would be adjusted as if it didn't."""
    written(tmp_path)
    with pytest.raises(InputError, match=f"{key.split()[0]} for image.cub, which is read as cube"):
        decode(case_of_images(tmp_path, f'image = "image.cub"\n{key}'))
