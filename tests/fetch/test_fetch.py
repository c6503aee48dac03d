"""From ids to a folder: what is fetched, what a second run does, what is locked, and the case that it leaves."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import flaky_archive
import mgs
import numpy as np
import pytest
from commands import COMMAND, call, refusal
from flaky_archive import Flaky, cut, stall, status, web_page

import mgsgraph
from mgsgraph.case.case_file import decode
from mgsgraph.errors import InputError
from mgsgraph.fetch.case_file import camera_focal_length
from mgsgraph.fetch.download import RetryPolicy
from mgsgraph.fetch.folder import Fetched, fetch_images
from mgsgraph.fetch.needs import Archives
from mgsgraph.fetch.store import Lock
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.writing import claimed
from mgsgraph.geometry.trajectory import tdb_of_utc

QUICK = RetryPolicy(tries=3, first_wait=0.001, longest_wait=0.01, connecting=20.0, reading=20.0)
ONE, OTHER, LATE = "M04/02852", "m0402856", "R10-00002"
KERNELS = ("de405.bsp", "mgs_map2.bsp", "mgs_moc_v20.ti", "mgs_sc_map2.bc", "mgs_sclkscet_00061.tsc", "mgs_v10.tf",
           "naif0012.tls", "pck00009.tpc")  # fmt: skip


def fetch(archive: Flaky, folder: Path, *images: str, **more: Any) -> Fetched:
    return fetch_images(images or (ONE,), folder, archives=Archives.under(archive.address), retry=QUICK, **more)


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_all_that_one_image_needs(archive: Flaky, tmp_path: Path) -> None:
    fetched = fetch(archive, tmp_path / "d")
    assert {name for name in files(tmp_path / "d") if not name.startswith("index/")} == {
        "case.toml", "fetch.lock", "images/m0402852.imq", "kernels/mgs.tm", "pedr/ap12058l.b",
        "kernels/mgs_map2.lbl", "kernels/mgs_sc_map2.lbl", *(f"kernels/{name}" for name in KERNELS),
        *(f"megdr/meg{kind}90n000eb.{suffix}" for kind in "rt" for suffix in ("img", "lbl")),
    }  # fmt: skip
    (image,) = fetched.images
    assert image.orbit == 2063  # by its time: its label says none
    assert image.kernels == ("spk/mgs_map2.bsp", "ck/mgs_sc_map2.bc")
    assert all("no laser" not in note for note in fetched.notes)
    for name, content in archive.files.items():
        if (copy := tmp_path / "d" / "kernels" / Path(name).name).exists() and name.startswith("kernels/"):
            assert copy.read_bytes() == content
    assert len(archive.requests("images/mgsc_1030/m04028/m0402852.imq")) == 2  # its head, then all


def test_a_second_run_needs_no_network(archive: Flaky, tmp_path: Path) -> None:
    first = fetch(archive, tmp_path / "d")
    before = {name: (tmp_path / "d" / name).read_bytes() for name in files(tmp_path / "d")}
    archive.asked.clear()
    again = fetch(archive, tmp_path / "d")
    assert not archive.asked
    assert (again.brought, again.here) == ({}, len(first.brought))
    assert before == {name: (tmp_path / "d" / name).read_bytes() for name in files(tmp_path / "d")}
    nobody = Archives.under("http://127.0.0.1:1")
    assert fetch_images([ONE], tmp_path / "d", archives=nobody, retry=QUICK).here == len(first.brought)


def test_another_image_shares_what_it_can(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d")
    archive.asked.clear()
    both = fetch(archive, tmp_path / "d", OTHER)
    assert [str(image.product) for image in both.images] == ["M04/02852", "M04/02856"]
    assert set(both.brought) == {"images/m0402856.imq"}
    case = decode(both.case)
    assert [image.name for image in case.images] == ["M04-02852", "M04-02856"]
    assert [(profile.file, profile.image) for profile in case.shots] == [
        ("pedr/ap12058l.b", "M04-02852"), ("pedr/ap12058l.b", "M04-02856"),
    ]  # fmt: skip
    assert len(both.commands()) == 4
    together = fetch(archive, tmp_path / "e", ONE, OTHER)
    assert files(tmp_path / "d") == files(tmp_path / "e")
    assert (tmp_path / "d" / "case.toml").read_bytes() == (tmp_path / "e" / "case.toml").read_bytes()
    assert len(together.brought) == len(Lock.read(tmp_path / "e").files)


def test_an_image_after_the_last_range(archive: Flaky, tmp_path: Path) -> None:
    fetched = fetch(archive, tmp_path / "d", LATE, terrain="none")
    assert fetched.images[0].kernels == ("spk/mgs_ext12.bsp", "ck/mgs_sc_ext12.bc")
    assert "R10/00002: no laser profile, MOLA's ranging ended on 2001-06-30" in fetched.notes
    case = decode(fetched.case)
    assert not case.shots
    assert case.terrain == ()
    assert not [name for name in files(tmp_path / "d") if name.startswith(("pedr", "megdr"))]


@pytest.mark.parametrize("listed", [True, False])
def test_profiles_of_no_such_day(archive: Flaky, tmp_path: Path, listed: bool) -> None:
    del archive.files["pedr/ap12xxx/ap12058l.b"]
    if not listed:
        archive.stays["pedr/ap12xxx/"] = status(404)
    fetched = fetch(archive, tmp_path / "d", terrain="none")
    assert any("ap12046l.b ends at 1999-08-24T04:23:08 before it" in note for note in fetched.notes)
    assert not decode(fetched.case).shots
    del archive.files["pedr/ap12xxx/ap12046l.b"]
    fetched = fetch(archive, tmp_path / "e", terrain="none")
    assert any("has no file of its day" in note for note in fetched.notes)


def test_archives_without_listings(archive: Flaky, tmp_path: Path) -> None:
    archive.stays["images/"], archive.stays["pedr/ap12xxx/"] = status(403), status(404)
    with pytest.raises(InputError, match=r"no volume there.*--volume"):
        fetch(archive, tmp_path / "d", terrain="none")
    fetched = fetch(archive, tmp_path / "d", terrain="none", volumes=("MGSC_1030",))
    assert fetched.images[0].image == "mgsc_1030/m04028/m0402852.imq"
    assert fetched.images[0].pedr == "ap12xxx/ap12058l.b"
    with pytest.raises(InputError, match="in no volume"):
        fetch(archive, tmp_path / "f", terrain="none", volumes=("mgsc_1029",))


def test_an_index_that_leads_out_of_its_volume(archive: Flaky, tmp_path: Path) -> None:
    name = "images/mgsc_1030/index/imgindx.tab"
    archive.files[name] = archive.files[name].replace(b"M04028/M0402852.IMQ", b"../../../2852.IMQ  ")
    with pytest.raises(InputError, match="a path such as"):
        fetch(archive, tmp_path / "d", terrain="none")


def test_an_image_that_its_label_says_is_none_of_the_narrow_angle(archive: Flaky, tmp_path: Path) -> None:
    archive.files["images/mgsc_1030/m04028/m0402852.imq"] = flaky_archive.image(
        "M04/02852", "1999-08-24T14:12:13", "1999-08-24T14:12:19", instrument="MOC-WA"
    )
    with pytest.raises(InputError, match="MOC-WA; expected one of the narrow angle"):
        fetch(archive, tmp_path / "d", ONE)


def test_faults_on_the_way_are_got_over(archive: Flaky, tmp_path: Path) -> None:
    """A clean run, and one with a fault on nearly every file, leave the same."""
    fetch(archive, tmp_path / "clean")
    asked = dict.fromkeys(name for name, _ in archive.asked if name in archive.files)
    for k, name in enumerate(asked):
        archive.faults[name].append((cut(10), status(503), status(429))[k % 3])
    fetch(archive, tmp_path / "rough")
    assert files(tmp_path / "clean") == files(tmp_path / "rough")
    for name in files(tmp_path / "clean") - {"fetch.lock"}:
        assert (tmp_path / "clean" / name).read_bytes() == (tmp_path / "rough" / name).read_bytes(), name


def test_what_came_before_a_failure_is_kept(archive: Flaky, tmp_path: Path) -> None:
    archive.stays["pedr/ap12xxx/ap12058l.b"] = cut(0)
    with pytest.raises(InputError, match=r"ap12058l\.b.*3 times in a row"):
        fetch(archive, tmp_path / "d")
    assert not (tmp_path / "d" / "case.toml").exists()
    archive.stays.clear()
    archive.faults["megdr/meg016/megr90n000eb.img"].append(web_page)
    with pytest.raises(InputError, match="a web page instead of the file"):
        fetch(archive, tmp_path / "d")
    archive.asked.clear()
    fetch(archive, tmp_path / "d")
    assert {name.split("/")[0] for name, _ in archive.asked} == {"megdr"}
    assert not [name for name in files(tmp_path / "d") if ".part" in name or "unfinished" in name]


def test_a_file_that_differs_from_the_lock_is_fetched_again(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d")
    image = tmp_path / "d" / "images" / "m0402852.imq"
    good = image.read_bytes()
    image.write_bytes(good[:-1] + b"x")
    (tmp_path / "d" / "kernels" / "de405.bsp").unlink()
    archive.asked.clear()
    fetched = fetch(archive, tmp_path / "d")
    assert image.read_bytes() == good
    assert set(fetched.brought) == {"images/m0402852.imq", "kernels/de405.bsp"}
    assert [note for note in fetched.notes if "not as fetch.lock has it (another SHA-256)" in note]
    assert len(archive.asked) == 2


def test_all_that_is_locked_is_brought_again(archive: Flaky, tmp_path: Path) -> None:
    """Also what this run does not ask for: indices, and the grids of another choice."""
    fetch(archive, tmp_path / "d", terrain="4")
    gone = {"index/mgsc_1030.tab", "kernels/mgs_map2.lbl", "megdr/megr90n000cb.img"}
    for name in gone:
        (tmp_path / "d" / name).unlink()
    fetched = fetch(archive, tmp_path / "d", terrain="none")
    assert set(fetched.brought) == gone
    assert sum("(missing), and was fetched again" in note for note in fetched.notes) == 3
    lock = Lock.read(tmp_path / "d")
    assert all(map(lock.whole, lock.files))
    assert len(lock.files) == fetched.here + 3


def test_one_at_a_time_fetches_into_a_folder(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d", terrain="none")
    before = {name: (tmp_path / "d" / name).read_bytes() for name in files(tmp_path / "d")}
    with claimed(tmp_path / "d", "x"), pytest.raises(InputError, match="another mgsgraph is fetching into it; wait"):
        fetch(archive, tmp_path / "d", OTHER)
    assert before == {name: (tmp_path / "d" / name).read_bytes() for name in files(tmp_path / "d")}
    fetch(archive, tmp_path / "d", OTHER, terrain="none")


def test_content_that_has_changed_at_the_archive(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d")
    kernel = tmp_path / "d" / "kernels" / "de405.bsp"
    locked = (tmp_path / "d" / "fetch.lock").read_bytes()
    archive.files["kernels/spk/de405.bsp"] = other = flaky_archive.daf("SPK", b"other planets")
    fetch(archive, tmp_path / "d")  # it is here, and whole
    kernel.unlink()
    with pytest.raises(InputError, match=r"another content .* than fetch\.lock has.*another folder"):
        fetch(archive, tmp_path / "d")
    assert not kernel.exists()
    assert (tmp_path / "d" / "fetch.lock").read_bytes() == locked
    fetch(archive, tmp_path / "e")
    assert (tmp_path / "e" / "kernels" / "de405.bsp").read_bytes() == other


def entry(name: str, size: object, url: str = "http://x.org/a") -> str:
    file = {"url": url, "size": size, "sha256": "", "fetched": ""}
    return json.dumps({"format": 1, "files": {name: file}, "images": {}, "written": {}})


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "{}", '{"format": 9}', '{"format": 1, "files": {"a": 3}, "images": {}}', entry("index/a.tab", "1"),
     entry("../a.tab", 1), entry("index/../a.tab", 1), entry("index/a/../../a.tab", 1), entry("index/a.tab", 1, "ftp://x.org/a")],
)
def test_a_lock_that_is_none(archive: Flaky, tmp_path: Path, text: str) -> None:
    (tmp_path / "fetch.lock").write_text(text)
    with pytest.raises(InputError, match=r"fetch\.lock") as error:
        fetch(archive, tmp_path)
    assert "\n" not in str(error.value)
    assert not archive.asked


@pytest.mark.parametrize("change", [{"box": ["nan", 1, 2, 3]}, {"image": 5}, {"kernels": 5}, {"product": "Q"}])
def test_an_entry_of_an_image_that_is_none(archive: Flaky, tmp_path: Path, change: dict[str, object]) -> None:
    fetch(archive, tmp_path, terrain="none")
    path = tmp_path / "fetch.lock"
    content = json.loads(path.read_text())
    content.pop("crc32", None)
    content["images"]["M04/02852"] |= change
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"fetch\.lock"):
        Lock.read(tmp_path)


@pytest.mark.parametrize("value", ["++1", "1e999", "0", "13.0", " " * 100_000])
def test_an_instrument_kernel_with_a_pixel_that_is_none(tmp_path: Path, value: str) -> None:
    (tmp_path / "kernels").mkdir()
    kernel = tmp_path / "kernels" / "mgs_moc_v20.ti"
    kernel.write_text(f"INS-94031_PIXEL_SIZE = ( {value} )\n")
    with pytest.raises(InputError, match=r"mgs_moc_v20\.ti"):
        camera_focal_length(tmp_path)


def test_folders_that_are_not_ours(archive: Flaky, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"has no fetch\.lock"):
        fetch(archive, tmp_path)
    with pytest.raises(InputError, match="exists and is a file"):
        fetch(archive, tmp_path / "mine.txt")
    assert not archive.asked
    assert files(tmp_path) == {"mine.txt"}


def test_without_requests(archive: Flaky, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "requests", None)
    with pytest.raises(InputError, match=r"pip install 'mgsgraph\[fetch\]'"):
        fetch(archive, tmp_path / "d")
    assert not (tmp_path / "d").exists()


def test_a_case_that_the_user_has_changed_stays(archive: Flaky, tmp_path: Path) -> None:
    case = fetch(archive, tmp_path / "d").case
    case.write_text(mine := case.read_text() + "\n# mine\n")
    fetched = fetch(archive, tmp_path / "d", OTHER)
    assert case.read_text() == mine
    assert [note for note in fetched.notes if "was left alone" in note]
    case.unlink()
    case.mkdir()
    with pytest.raises(InputError, match=r"case\.toml: a folder; expected a file"):
        fetch(archive, tmp_path / "d")
    case.rmdir()
    assert len(decode(fetch(archive, tmp_path / "d").case).images) == 2


def test_a_meta_kernel_that_the_user_has_changed_stays(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d", terrain="none")
    kernel, lock = tmp_path / "d" / "kernels/mgs.tm", tmp_path / "d" / "fetch.lock"
    before = kernel.read_text()
    kernel.write_text(mine := before + "\nmine\n")
    fetched = fetch(archive, tmp_path / "d", LATE, terrain="none")
    assert [note for note in fetched.notes if "mgs.tm is not as it was written here" in note]
    assert kernel.read_text() == mine
    kernel.write_text(before)  # of an earlier version, whose lock knows nothing of it
    content = json.loads(lock.read_text())
    del content["written"]["kernels/mgs.tm"], content["crc32"]
    lock.write_text(json.dumps(content))
    fetch(archive, tmp_path / "d", terrain="none")
    assert "mgs_ext12.bsp" in kernel.read_text()


@pytest.mark.parametrize("name", ["images", "index", "kernels", "shots"])
def test_a_folder_with_planted_links_is_refused(archive: Flaky, tmp_path: Path, name: str) -> None:
    fetch(archive, tmp_path / "d", terrain="none")
    (tmp_path / "victim").mkdir()
    inside = tmp_path / "d" / name
    if inside.exists():
        inside.rename(tmp_path / "d" / "aside")
    inside.symlink_to(tmp_path / "victim")
    with pytest.raises(InputError, match=f"d/{name}: a link, and what it leads to would be written into"):
        fetch(archive, tmp_path / "d", OTHER, terrain="none")
    assert not list((tmp_path / "victim").iterdir())


def test_a_file_that_is_a_link_is_fetched_again(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d", terrain="none")
    kernel, victim = tmp_path / "d" / "kernels/naif0012.tls", tmp_path / "victim"
    kernel.rename(victim)
    kernel.symlink_to(victim)
    fetched = fetch(archive, tmp_path / "d", terrain="none")
    assert any("naif0012.tls was not as fetch.lock has it (a link)" in note for note in fetched.notes)
    assert not kernel.is_symlink()
    assert kernel.read_bytes() == victim.read_bytes()


def test_words_of_an_archive_go_to_the_terminal_as_text(archive: Flaky, tmp_path: Path) -> None:
    said = list[str]()
    name = "kernels/pck/pck00009.tpc"

    def busy(one: flaky_archive.Handler, content: bytes) -> None:
        one.send_response(503, "\x1b[31mred\x1b]0;title\x07")
        one.send_header("Content-Length", "0")
        one.end_headers()

    archive.faults[name].append(busy)
    fetch(archive, tmp_path / "d", terrain="none", say=said.append)
    (sentence,) = said
    assert sentence.isprintable()
    assert sentence.startswith(archive.url(name))
    assert sentence.endswith("tried again in 0 s")


def test_tiles_need_the_images_place(archive: Flaky, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"M04/02852, whose place its tiles depend on"):
        fetch(archive, tmp_path / "d", terrain="128")


def real_files(shared_data: Path) -> dict[str, bytes]:
    """M04/02852 with its real kernels; its pixels are made up, and there is one tile where it was taken."""
    data, content = shared_data / "mgs_moc_m0402852", flaky_archive.archive_files()
    for name, place in (
        ("naif0012.tls", "leap_seconds/naif0012.tls"),
        ("MGS_SCLKSCET.00061.tsc", "kernels/sclk/mgs_sclkscet_00061.tsc"),
        ("pck00009.tpc", "kernels/pck/pck00009.tpc"), ("moc20.ti", "kernels/ik/mgs_moc_v20.ti"),
        ("m0402852.ale_0.bsp", "kernels/spk/de405.bsp"), ("m0402852.ale_1.bsp", "kernels/spk/mgs_map2.bsp"),
        ("mgs_sc_map2_1_sliced_-94000.bc", "kernels/ck/mgs_sc_map2.bc"),
    ):  # fmt: skip
        content[place] = (data / name).read_bytes()
    content["images/mgsc_1030/m04028/m0402852.imq"] = mgs.image_bytes()
    for name in ("megr44s090hb", "megr44s180hb", "megr44s000hb", "megr44s270hb"):
        for kind in (name, name.replace("megr", "megt")):
            content[f"megdr/meg128/{kind}.img"] = bytes(100)
            content[f"megdr/meg128/{kind}.lbl"] = flaky_archive.label(RECORD_BYTES="2")
    return content


def test_real_kernels_give_the_geometry_that_isis_has(archive: Flaky, shared_data: Path, tmp_path: Path) -> None:
    archive.files = real_files(shared_data)
    fetched = mgsgraph.fetch_images(
        [ONE], tmp_path / "d", archives=Archives.under(archive.address), terrain="128", retry=QUICK
    )
    assert not fetched.notes
    case, folder = decode(fetched.case), fetched.folder
    image = case.images[0]
    assert case.spice is not None
    kernels = [folder / name for name in case.spice.kernels]
    taken = read_labelled_image(
        folder / str(image.label), kernels, constants=image.constants, focal_length=image.focal_length_m
    )
    assert taken.trajectory.epoch == pytest.approx(mgs.START, abs=1.0)
    by_isis = read_labelled_image(folder / str(image.label), mgs.kernels(shared_data), constants="iak")
    lines, samples = np.array([0.0, 3.0, 6.0]), np.array([0.0, 128.0, 256.0])
    one, _ = taken.image_to_ground(lines, samples)
    other, _ = by_isis.image_to_ground(lines, samples)
    assert np.linalg.norm(one - other, axis=1).max() < 0.03  # m; 0.016, and up to 6.7 with NAIF's 3.5 m
    assert case.terrain is not None
    assert [name for name in files(folder) if name.endswith("hb.lbl") and "megr" in name] == [
        f"megdr/{Path(case.terrain.grids[0]).name}"
    ]
    assert tdb_of_utc([fetched.images[0].start], "x")[0] == pytest.approx(mgs.START, abs=0.01)
    assert camera_focal_length(folder) == pytest.approx(3.466916, abs=1e-6)


# --- as a person uses it


def test_fetch(archive: Flaky, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "a folder"
    assert call("fetch", "M04/02852", "m0402856", "--mirror", archive.address, "--out", out) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "- M04/02852: 1999-08-24T14:12:13.64, orbit 2063, mgs_map2.bsp, mgs_sc_map2.bc, ap12058l.b"
    assert f"  mgsgraph project init '{out}/project' --case '{out}/case.toml'" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["M04/02853"], "of the wide angle (MOC-WA)"),
        (["M04/02999"], "in no volume that was looked through (mgsc_1029, mgsc_1030, mgsc_1280)"),
        (["M24/00001"], "expected phases M00 .. M23"),
        (["M04/02852", "--volume", "1030"], "volume '1030': not the name of a volume; expected one such as mgsc_1068"),
        (["nonsense"], "not the id of an image of MOC, CTX, LROC NAC or HRSC; expected one such as E02/00665"),
        ([], "at least one id"),
        (["M04/02852", "--mirror", "nowhere.toml"], "nowhere.toml: no such file"),
        (["M04/02852", "--mirror", "ftp://x.org"], "an address such as https://"),
    ],
)
def test_one_line_for_errors(archive: Flaky, tmp_path: Path, arguments: list[str], said: str) -> None:
    where = [] if any(one.startswith("--") for one in arguments) else ["--mirror", archive.address]
    assert said in refusal("fetch", *arguments, *where, "--out", tmp_path / "out")


def test_an_interrupted_fetch_goes_on(archive: Flaky, tmp_path: Path) -> None:
    """It waits for no silent server, and the same command takes up what had come."""
    name, over = "megdr/meg016/megr90n000eb.img", threading.Event()
    archive.faults[name].append(stall(3000, over))
    arguments = [*COMMAND, "fetch", "M04/02852", "--mirror", archive.address, "--out", str(tmp_path / "out")]
    running = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    part = tmp_path / "out" / f"megdr/{Path(name).name}.part"
    deadline = time.monotonic() + 30.0
    while not (part.exists() and part.stat().st_size == 3000) and time.monotonic() < deadline:
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    _, error = running.communicate(timeout=60.0)  # the server is silent for 120 s
    over.set()
    assert running.returncode == 130
    assert error == "mgsgraph: interrupted; what has come is kept, the same command goes on\n"
    archive.asked.clear()
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=60, env=os.environ)
    assert "The case is" in done.stdout
    assert archive.requests(name) == ["bytes=3000-"]
    assert not list((tmp_path / "out").rglob("*.part*"))
