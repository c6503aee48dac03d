"""`mgsgraph new`: the case that it writes is one that `check` accepts, or it says why there can be none."""

import json
import os
import re
from pathlib import Path

import numpy as np
import profiles
import pytest
from commands import refused, run
from outside import refuses

import mgsgraph
from mgsgraph.case import draft
from mgsgraph.case.case_file import decode
from mgsgraph.case.draft import draft_case
from mgsgraph.case.draft_images import DraftImage, named_as
from mgsgraph.errors import InputError
from mgsgraph.files.kinds import Kind
from mgsgraph.results.inventory import images_inventory
from mgsgraph.simulation.pair import simulate_pair


def test_a_case_of_a_folder(case_file: Path, tmp_path: Path) -> None:
    (case_file.parent / "notes.bin").write_bytes(b"\0\1\2")
    out = tmp_path / "made" / "case.toml"
    done = run("new", case_file.parent, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "notes.bin" in done.stdout
    assert done.stdout.splitlines()[-1] == f"Next: mgsgraph check {out}"
    wanted, before = decode(out), mgsgraph.read_case(case_file).network
    after = mgsgraph.read_case(out).network
    assert [image.name for image in wanted.images] == ["SIM/A", "SIM/B"]
    assert (len(after.points), after.ranges.point.size) == (len(before.points), before.ranges.point.size)
    refuses("there already", draft_case, [case_file.parent], out)
    assert draft_case([case_file.parent], out, replace=True).text == out.read_text(encoding="utf-8")


def test_products_are_known_however_they_are_written() -> None:
    images = tuple(
        DraftImage(Path(f"{k}.img"), Kind.PDS3, f"MGS/66852320{k}:87/MOC", frozenset({f"E02/0066{k}"}), image, True)
        for k, image in enumerate(simulate_pair().images)
    )
    named, missing = named_as(images, ["e0200661", "E02-00660", "M01-00115"])
    assert [one.name for one in named] == ["E02-00660", "e0200661"]
    assert missing == ("M01-00115",)


def test_support_data_by_name_take_the_serial_number_of_their_label(shared_data: Path, tmp_path: Path) -> None:
    folder, out = shared_data / "lro_nac_lola", tmp_path / "case.toml"
    draft_case([*folder.glob("lidarObservationImage?.isd"), folder / "network.pvl"], out)
    images = mgsgraph.read_case(out).network.image_names
    assert images == ["LRO/1/286265995:36824/NACL", "LRO/1/286272781:34203/NACL"]


def test_images_alone_make_a_case_for_match(case_file: Path, tmp_path: Path) -> None:
    files, out = sorted(case_file.parent.glob("*.isd")), tmp_path / "a case.toml"
    assert draft_case(files, out).command == f"mgsgraph check '{out}'"
    said = images_inventory(out)
    assert said is not None
    assert "overlap by" in said
    assert f"mgsgraph match '{out}'" in said


def test_check_opens_the_shots_of_a_case_without_measures(case_file: Path, tmp_path: Path) -> None:
    profiles.write_profile(tmp_path / "p.csv")
    out = tmp_path / "case.toml"
    draft_case(sorted(case_file.parent.glob("*.isd")), out)
    text = out.read_text(encoding="utf-8")
    out.write_text(f'{text}\n[[shots]]\nfile = "p.csv"\n[[altimetry]]\nfile = "p.csv"\n', encoding="utf-8")
    said = images_inventory(out)
    assert said is not None
    assert f"p.csv: {profiles.SHOTS} shots of MOLA" in said
    assert f"SIM/A: {profiles.SHOTS} shots of 1 profile fall in it, 18933 taken along" in said
    assert f"p.csv: {profiles.SHOTS} ground returns in 1 profile" in said
    (tmp_path / "p.csv").write_text("no,shots\n1,2\n", encoding="utf-8")
    refuses(r"p\.csv", images_inventory, out)


def test_what_does_not_go_with_the_rest_is_left_out_with_the_reason(case_file: Path, tmp_path: Path) -> None:
    network = case_file.with_name("network.pvl")
    other = tmp_path / "other.pvl"
    other.write_text(network.read_text(encoding="utf-8").replace("SIM/B", "NOT/HERE"), encoding="utf-8")
    lunar = tmp_path / "lunar.pvl"
    text, count = re.subn(r"TargetName\s*=\s*\S+", "TargetName = Moon", network.read_text(encoding="utf-8"))
    assert count == 1
    lunar.write_text(text, encoding="utf-8")
    made = draft_case([case_file.parent, other, lunar], tmp_path / "case.toml")
    assert re.search("^# Left out: lunar.pvl: .*Moon.*MARS", made.text, re.MULTILINE)
    assert "NOT/HERE" in "\n".join(made.said)
    assert re.search(r"^# Left out: other.pvl: ", made.text, re.MULTILINE)
    assert [entry.network for entry in decode(tmp_path / "case.toml").tie_groups] == ["case/network.pvl"]


def test_one_image_in_two_files_is_taken_once(case_file: Path, tmp_path: Path) -> None:
    isd = case_file.with_name("image_A.isd")
    (tmp_path / "copy.json").write_bytes(isd.read_bytes())
    draft_case([case_file.parent, tmp_path / "copy.json"], tmp_path / "case.toml")
    assert len(decode(tmp_path / "case.toml").images) == 2
    twice = tmp_path / "twice.toml"
    text = (tmp_path / "case.toml").read_text(encoding="utf-8")
    twice.write_text(text + '\n[[images]]\nname = "again"\nimage = "copy.json"\n', encoding="utf-8")
    refuses("one image", mgsgraph.read_case, twice)


def test_nothing_to_make_a_case_of(case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "case.toml"
    refused(run("new", case_file.with_name("network.pvl"), "--out", out), "no image: it holds a control network")
    cut = tmp_path / "cut.isd"
    cut.write_bytes(case_file.with_name("image_A.isd").read_bytes()[:-100])
    wrong = {cut: "malformed or truncated JSON", case_file: "a TOML file with a format", tmp_path / "none": "no such"}
    for given, said in wrong.items():
        refuses(said, draft_case, [given], out)
    assert not out.exists()
    for place, said in ((tmp_path, "a folder"), (Path("/dev/null/x.toml"), "can't be written")):
        refuses(said, draft_case, [case_file.parent], place)


def test_a_list_whose_files_are_gone_and_files_of_asp_say_what_to_do(case_file: Path, tmp_path: Path) -> None:
    lines = [str(case_file.with_name("image_A.isd")), "gone.cub"]
    (tmp_path / "images.lis").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "run-a.adjust").write_text("0 0 0\n1 0 0 0\n", encoding="utf-8")
    for name, said in (("images.lis", r"images\.lis, line 2: 'gone\.cub'"), ("run-a.adjust", r"adjusted_state\.json")):
        refuses(said, draft_case, [tmp_path / name], tmp_path / "case.toml")


def test_a_raster_of_heights_gets_the_sphere_that_they_may_be_above(case_file: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    for name, kind in (("heights.tif", "float32"), ("picture.tif", "uint8")):
        with rasterio.open(
            tmp_path / name, "w", driver="GTiff", height=300, width=400, count=1, dtype=kind,
            crs="+proj=longlat +R=3396190 +no_defs", transform=rasterio.Affine(0.01, 0, 86, 0, -0.01, 5.5),
        ) as file:  # fmt: skip
            file.write(np.full((1, 300, 400), 100, dtype=kind))
    draft_case([case_file.parent, tmp_path / "heights.tif"], tmp_path / "case.toml")
    (terrain,) = decode(tmp_path / "case.toml").terrain_models
    assert (terrain.radius, terrain.reference_radius_m) == ("heights.tif", 3396190.0)
    draft_case([case_file.parent, tmp_path / "picture.tif"], tmp_path / "case.toml", replace=True)
    assert not decode(tmp_path / "case.toml").terrain_models


def test_files_of_one_name_in_two_folders_are_two_images(case_file: Path, tmp_path: Path) -> None:
    for folder, image in (("a", "image_A.isd"), ("b", "image_B.isd")):
        (tmp_path / folder).mkdir()
        text = case_file.with_name(image).read_text(encoding="utf-8")
        (tmp_path / folder / "x.isd").write_text(re.sub(r'"image_identifier": *"[^"]*",?', "", text), encoding="utf-8")
    draft_case([tmp_path / "a", tmp_path / "b"], tmp_path / "case.toml")
    assert {image.name for image in decode(tmp_path / "case.toml").images} == {"x", "b/x"}


PLATFORMS = {
    "MGS": "MARS GLOBAL SURVEYOR", "MRO": "Mars_Reconnaissance_Orbiter", "LRO": "LUNAR RECONNAISSANCE ORBITER",
    "KAGUYA": "SELENE-M", "MEX": "MARS EXPRESS", "": "MARS ODYSSEY",
}  # fmt: skip
"""What support data call the spacecraft of a mission."""


def flown_by(case_file: Path, **platforms: str) -> list[Path]:
    """Support data of images A and B, as of other spacecraft."""
    files = [case_file.with_name(f"image_{name}.isd") for name in platforms]
    for file, platform in zip(files, platforms.values(), strict=True):
        text, count = re.subn(r'("name_platform": *")[^"]*', rf"\g<1>{platform}", file.read_text(encoding="utf-8"))
        assert count == 1
        file.write_text(text, encoding="utf-8")
    return files


def documented(mission: str) -> np.ndarray:
    """(6,) sigmas in m and rad, as docs/case_file.md has them."""
    page = (Path(__file__).parents[2] / "docs" / "case_file.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {mission or 'other missions'} \| ([\d.]+) \| ([\d., ]+) \|", page, re.MULTILINE)
    assert row is not None
    return np.append(np.full(3, float(row[1])), np.broadcast_to(np.fromstring(row[2], sep=","), 3) * 1e-3)


@pytest.mark.parametrize("mission", PLATFORMS)
def test_sigmas_of_the_mission_are_written_and_the_default(case_file: Path, tmp_path: Path, mission: str) -> None:
    files, out = flown_by(case_file, A=PLATFORMS[mission], B=PLATFORMS[mission]), tmp_path / "case.toml"
    draft_case([*files, case_file.with_name("network.pvl")], out)
    written = out.read_text(encoding="utf-8")
    np.testing.assert_array_equal(decode(out).orientation.prior("").sigmas[0], documented(mission))
    for text in (written, re.sub("^(position|angle)_sigma.*$", "", written, flags=re.MULTILINE)):
        out.write_text(text, encoding="utf-8")
        for prior in mgsgraph.read_case(out).network.priors:
            np.testing.assert_allclose(prior.sigmas, np.outer([1.0, 0.1, 0.01], documented(mission)), rtol=1e-12)


def test_images_of_two_missions_have_their_own_sigmas(case_file: Path, tmp_path: Path) -> None:
    files, out = flown_by(case_file, A=PLATFORMS["MRO"], B=PLATFORMS["MEX"]), tmp_path / "case.toml"
    made = draft_case([*files, case_file.with_name("network.pvl")], out)
    assert sum("Robbins" in line or "Spiegel" in line for line in made.said) == 2
    for prior, mission in zip(mgsgraph.read_case(out).network.priors, ("MRO", "MEX"), strict=True):
        np.testing.assert_allclose(prior.sigmas[0], documented(mission), rtol=1e-12)
    said = run("check", out).stdout
    assert "orbit 63 m" in said
    assert "pointing 90.8 arcsec" in said


SLOW = pytest.mark.slow
REAL = {
    "mgs_moc_wa_three": (3, "MGS"), "lro_nac_hadley": (2, "LRO"), "lro_nac_lola": (2, "LRO"),
    "mgs_moc_m0402852": (1, "MGS"), "mgs_moc_pair": (2, "MGS"), "kaguya_tc": (1, "KAGUYA"),
    "mex_hrsc_h5270": (1, "MEX"), "mro_ctx_b10": (1, "MRO"), "mro_ctx_isds": (8, "MRO"), "usgscsm_states": (1, ""),
}  # fmt: skip
"""Images that the case of a folder of real data has, and their mission."""


@pytest.mark.parametrize("folder", [pytest.param(one, marks=() if one == "mgs_moc_wa_three" else SLOW) for one in REAL])
def test_real_data_make_a_case_that_check_accepts(shared_data: Path, tmp_path: Path, folder: str) -> None:
    out = tmp_path / "case.toml"
    made = draft_case([shared_data / folder], out)
    wanted = decode(out)
    count, mission = REAL[folder]
    assert len(wanted.images) == count
    np.testing.assert_allclose(wanted.orientation.prior("").sigmas[0], documented(mission), rtol=1e-12)
    assert ("# [[altimetry]]" in made.text) == (folder == "lro_nac_hadley")
    if folder == "mgs_moc_pair":  # of one image nothing says where it is
        refuses(r"no tie point that .* longitude_deg and latitude_deg of its middle", images_inventory, out)
        return
    assert images_inventory(out) or mgsgraph.read_case(out).network.rays.point.size > 40


BARE = {
    "kernels": "no image: it holds a SPICE kernel", "mola_megdr": "terrain model", "mola_pedr_ode": "laser shots",
    "lro_nac_m103595705": "PCK",
}  # fmt: skip


@pytest.mark.parametrize("folder", BARE)
def test_a_folder_that_alone_can_t_be_a_case_says_why(shared_data: Path, tmp_path: Path, folder: str) -> None:
    with pytest.raises(InputError, match=BARE[folder]) as caught:
        draft_case([shared_data / folder], tmp_path / "case.toml")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_label_without_line_times_gets_rough_ones_and_a_word(shared_data: Path, tmp_path: Path) -> None:
    made = draft_case([shared_data / "mex_hrsc_h5270"], tmp_path / "case.toml")
    assert re.search('^line_times = "mean" +# a rough guess', made.text, re.MULTILINE)
    assert any("rough" in line for line in made.said)


def test_names_that_toml_would_not_take_as_they_are(case_file: Path, tmp_path: Path) -> None:
    isd, out = case_file.with_name("image_A.isd"), tmp_path / "case.toml"
    content = json.loads(isd.read_text(encoding="utf-8"))
    for name in ('a"\n[solver]\nloss="x" #', "a\x7f\t\\u0041\x00", "a\u2028\r\n# b"):
        isd.write_text(json.dumps(content | {"image_identifier": name}), encoding="utf-8")
        made = draft_case([isd, case_file.with_name("image_B.isd")], out, replace=True)
        assert name in {image.name for image in decode(out).images}
        assert not re.search("[\x00-\x1f\x7f]", "".join(made.said))
    isd.write_text(json.dumps(content | {"image_identifier": "\ud800"}), encoding="utf-8")
    refuses("Unicode", draft_case, [isd], tmp_path / "other.toml")
    assert not (tmp_path / "other.toml").exists()


def test_what_can_t_be_read_gets_no_name(case_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draft, "_HEAD", "format = 1\nname = {name}\nunknown = 1\n")
    refuses("'unknown'", draft_case, [case_file.with_name("image_A.isd")], tmp_path / "case.toml")
    assert not (tmp_path / "case.toml").exists()


def test_a_case_is_called_as_its_file_or_as_the_folder_of_its_data(case_file: Path, tmp_path: Path) -> None:
    isd = case_file.with_name("image_A.isd")
    for given, out, name in (
        (isd, "case.toml", isd.parent.name), (isd.parent, "case.toml", isd.parent.name), (isd, "hadley.toml", "hadley")
    ):
        draft_case([given], tmp_path / out, replace=True)
        assert decode(tmp_path / out).name == name


def test_replace_is_for_case_files(case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "case.toml"
    out.write_text("[tool.black]\n", encoding="utf-8")
    refuses("exists and is not a case file", draft_case, [case_file.with_name("image_A.isd")], out, replace=True)
    assert out.read_text(encoding="utf-8") == "[tool.black]\n"


def test_a_hostile_folder(case_file: Path, tmp_path: Path) -> None:
    """Pipes, loops, names that are no text, records of ours, files without an end: left out, and most of them said."""
    folder = case_file.parent
    os.mkfifo(folder / "pipe.json")
    (folder / "loop.isd").symlink_to(folder / "loop.isd")
    (folder / "zero.cub").symlink_to("/dev/zero")
    Path(os.fsdecode(bytes(folder) + b"/image_\xff.isd")).write_bytes((folder / "image_A.isd").read_bytes())
    (folder / "export.json").write_text('{"program": "mgsgraph", "files": []}', encoding="utf-8")
    with (folder / "huge.img").open("wb") as file:
        file.truncate(1 << 40)
    for k in range(300):
        (folder / f"noise_{k}.bin").write_bytes(b"\0\1")
    made = draft_case([folder], tmp_path / "case.toml")
    assert [image.name for image in decode(tmp_path / "case.toml").images] == ["SIM/A", "SIM/B"]
    said = "\n".join(made.said)
    assert "export.json: a record of mgsgraph itself" in said
    assert "a name that is no Unicode text" in said
    named = sorted(folder.glob("*.isd*"))[:2]
    assert len(draft_case([*named, folder / "export.json"], tmp_path / "other.toml").text) > 100
    named.append(folder / "noise_1.bin")  # as a shell's * gives them
    assert "noise_1.bin" in "".join(draft_case(named, tmp_path / "starred.toml").said)
    refuses("a pipe; expected a file", draft_case, [*named, folder / "pipe.json"], tmp_path / "third.toml")
