"""The review page and its verdicts: what is chosen and said, what comes back, and what a real browser makes of it."""

import base64
import io
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import PIL.Image
import pytest
from chip_scene import PAIR, inner, moved, picture, ties_at
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from studio_server import CONTRAST

from mgsgraph.errors import InputError
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.tie_points import TiePoints, tie_points
from mgsgraph.studio.match_review import MatchReview, png, review_matches, write_review
from mgsgraph.studio.verdicts import (
    Verdict,
    Verdicts,
    apply_verdicts,
    ignore_rejected,
    network_digest,
    read_verdicts,
    write_kept,
)

TIES = moved(ties_at(inner(12)), np.array([5]), np.array([2.0, -1.5]))
"""P2's second measure is off."""


def made(ties: TiePoints = TIES, **wanted: Any) -> MatchReview:
    return review_matches(PAIR.images, ties, picture, name="pair", **wanted)


@pytest.fixture
def page(tmp_path: Path) -> Path:
    write_review(made(), tmp_path / "review.html")
    return tmp_path / "review.html"


def solution(ties: TiePoints, **changes: Any) -> Any:
    """What the review takes of an adjustment."""
    names = [image.name for image in PAIR.images]
    rays = SimpleNamespace(
        point=ties.measure_point, image=np.array([names.index(name) for name in ties.measure_image]),
        places=ties.measures,
    )  # fmt: skip
    network = SimpleNamespace(rays=rays, images=PAIR.images, points=SimpleNamespace(ids=ties.ids))
    k = ties.measure_point.size
    fields = {"residuals": np.zeros((k, 2)), "rays_rejected": np.zeros(k, dtype=bool)} | changes
    return SimpleNamespace(name="other", network=network, **fields)


# --- what is shown


def test_the_worst_come_by_each_measure_in_turn() -> None:
    """P2 correlates worst; P9 has the largest residual; P7 the rays that miss each other most, with its chips blank."""
    ties = moved(TIES, np.array([2 * 7 + 1]), np.array([2.5, 0.0]))
    residuals = np.full((24, 2), 0.1)
    residuals[2 * 9] = 3.0, 4.0
    found = made(ties, solution=solution(ties, residuals=residuals), worst=3)
    assert set(found.ties.ids) == {"P2", "P7", "P9"}
    assert found.choice.startswith("3 of 12 tie points: in turn the next by lowest correlation, ")
    assert found.figures["residual"][found.ties.ids.index("P9")] == 5.0
    assert found.digest == network_digest(ties) != network_digest(TIES)
    two = made(ties, worst=2)
    assert "residual" not in two.choice
    assert len(two.ties.ids) == 2


@pytest.mark.parametrize("worst", [12, 400])
def test_all_are_shown_where_there_are_no_more(worst: int) -> None:
    found = made(worst=worst)
    assert found.ties.ids == TIES.ids
    assert found.choice == "12 of 12 tie points: all of them"
    assert found.figures["correlation"].argmin() == 2


def test_points_by_name_keep_figures_of_the_whole_network() -> None:
    every, some = made(), made(points=("P5", "P2"))
    assert some.ties.ids == ("P2", "P5")
    assert np.array_equal(some.oddness, every.oddness[[2, 5]])
    assert np.array_equal(some.chips, every.chips[[4, 5, 10, 11]])
    assert some.digest == every.digest


def test_what_cannot_be_reviewed_is_refused() -> None:
    none = replace(TIES, ids=(), kinds=[], places=np.zeros((0, 3)), covariances=np.zeros((0, 3, 3)), measure_point=[],
                   measure_image=(), measures=np.zeros((0, 2)), measure_sigmas=np.zeros((0, 2)))  # fmt: skip
    with pytest.raises(InputError, match="no tie point"):
        made(none)
    with pytest.raises(InputError, match=r"no point P77, X; expected ids"):
        made(points=("P1", "X", "P77"))
    with pytest.raises(InputError, match="solution 'other', point P0, image SIM/A: measured at another place"):
        made(solution=solution(moved(TIES, np.array([0]), np.array([0.01, 0.0]))))
    with pytest.raises(InputError, match="point P0, image SIM/A: no such measure; expected the measures of test"):
        made(solution=solution(replace(TIES, ids=tuple(f"Q{i}" for i in range(12)))))


# --- the file


@settings(max_examples=20, deadline=None)
@given(hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=90)))
def test_pictures_are_read_by_others(grey: np.ndarray) -> None:
    with PIL.Image.open(io.BytesIO(png(grey))) as read:
        assert read.mode == "L"
        assert np.array_equal(np.asarray(read), grey)


def test_the_page_is_one_file_without_addresses(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    without_script = re.sub(r"<script>.*</script>", "", text, flags=re.DOTALL)
    assert not re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?(?!data:|#)[^"'\s>]""", without_script)
    assert not re.search(r"https?:|//[a-z]+\.", re.sub(r"base64,[^\"]*", "", text))
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert len(pictures) == 24
    assert all(base64.b64decode(one).startswith(b"\x89PNG") for one in pictures)
    assert page.stat().st_size < 12 * 20_000 + 30_000
    line, sample = TIES.measures[0]
    assert f"<td>{line + 0.5:.2f}</td><td>{sample + 0.5:.2f}</td>" in text
    assert list(page.parent.iterdir()) == [page]


def test_names_from_files_are_text(tmp_path: Path) -> None:
    evil = '"><script>alert(1)</script>'
    ties = replace(TIES, ids=(evil, *TIES.ids[1:]))
    write_review(made(ties), tmp_path / "p.html", Verdicts("v", {evil: Verdict.REJECT}, {evil: "</article>" + evil}))
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert text.count("<article") == 12 == text.count("</article>")


# --- verdicts


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", newline="")
    return path


def test_verdicts_are_read(tmp_path: Path) -> None:
    text = (
        "# any comment\n# network 0123456789abcdef,,\nid,verdict,note\nP1,accept,\n\n"
        '"P,2",Reject,"no, ""never""\nat all"\nP3,,\n#4,undecided,x\n'
    )
    found = read_verdicts(written(tmp_path / "v.csv", text))
    assert found.of == {"P1": "accept", "P,2": "reject", "P3": "undecided", "#4": "undecided"}
    assert found.notes == {"P,2": 'no, "never"\nat all', "#4": "x"}
    assert found.network == "0123456789abcdef"
    assert found.rejected == {"P,2"}
    short = read_verdicts(written(tmp_path / "short.csv", "\ufeffID,Verdict\r\nP1,reject\r\n"))
    assert short.of == {"P1": "reject"}
    assert not short.network


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "v.csv: nothing; expected the header id,verdict"),
        ("# network 0123456789abcdef\n\n", "v.csv: nothing; expected the header"),
        ("id;verdict\nP1;accept\n", "line 1: 'id;verdict'.*write commas"),
        ("P1,accept\n", "line 1: 'P1,accept'; expected the header"),
        ("id,verdict\nP1,accept\nP2,maybe\n", "line 3: the verdict 'maybe'; expected accept, reject, undecided"),
        ("id,verdict\nP1,accept\n\nP1,reject\n", "line 4: the id 'P1' a second time"),
        ("id,verdict\nP1\n", "line 2: 1 fields; expected 2"),
        ("id,verdict\nP1,accept,why\n", "line 2: 3 fields; expected 2 .*quote commas"),
        ("id,verdict\n,accept\n", "line 2: no id"),
        ('id,verdict,note\nP1,accept,"a\nb"\nP2,"rej"ect,\n', r"line 4: no CSV \("),
        ('id,verdict\nP1,"accept\n', r"line 2: no CSV \("),
        ("# network 0123456789abcdef\n# network 0123456789abcdee\nid,verdict\n", "about two networks"),
    ],
)
def test_bad_verdicts_are_refused_with_their_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_verdicts(written(tmp_path / "v.csv", text))


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_verdicts(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"id,verdict\n\xff\xfe,accept\n")
    with pytest.raises(InputError, match="not UTF-8"):
        read_verdicts(tmp_path / "b.csv")


@settings(max_examples=60, deadline=None)
@given(text=st.text(alphabet='id,verdict\n"\r;#acept rjuno\x00\\é', max_size=80))
def test_any_text_is_verdicts_or_refused(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = written(tmp_path_factory.mktemp("v") / "v.csv", "id,verdict,note\n" + text)
    with suppress(InputError):
        assert set(read_verdicts(path).of.values()) <= set(Verdict)


@given(which=st.sets(st.integers(0, 11), max_size=11))
@settings(max_examples=20, deadline=None)
def test_rejected_points_are_gone_and_no_others(which: set[int]) -> None:
    of = {name: Verdict.REJECT if i in which else Verdict.ACCEPT for i, name in enumerate(TIES.ids)}
    kept = apply_verdicts(TIES, Verdicts("v.csv", of, network=network_digest(TIES)))
    assert kept.ids == tuple(name for i, name in enumerate(TIES.ids) if i not in which)
    before = {(TIES.ids[i], image): place for i, image, place in
              zip(TIES.measure_point.tolist(), TIES.measure_image, TIES.measures.tolist(), strict=True)}  # fmt: skip
    after = {(kept.ids[i], image): place for i, image, place in
             zip(kept.measure_point.tolist(), kept.measure_image, kept.measures.tolist(), strict=True)}  # fmt: skip
    assert after == {key: place for key, place in before.items() if key[0] in kept.ids}


def test_verdicts_about_another_network_are_refused() -> None:
    with pytest.raises(InputError, match=r"v.csv: verdicts about 'Q1', 'Q2'; expected points of test"):
        apply_verdicts(TIES, Verdicts("v.csv", {"Q2": Verdict.ACCEPT, "Q1": Verdict.REJECT, "P1": Verdict.REJECT}))
    other = network_digest(moved(TIES, np.array([3]), np.array([0.0, 1e-9])))
    with pytest.raises(InputError, match=rf"verdicts about network {other}"):
        apply_verdicts(TIES, Verdicts("v.csv", {"P1": Verdict.REJECT}, network=other))
    with pytest.raises(InputError, match="every point of test rejected"):
        apply_verdicts(TIES, Verdicts("v.csv", dict.fromkeys(TIES.ids, Verdict.REJECT)))


def record() -> ControlNetwork:
    """A network with figures that no adjustment takes."""
    measures = (
        ControlMeasure("SIM/A", MeasureType.MANUAL, sample=100.25, line=30.5, chooser_name="me", log=((2, 0.75),)),
        ControlMeasure("SIM/B", MeasureType.CANDIDATE, sample=90.0, line=31.0, ignore=True, date_time="2001-01-01"),
    )
    points = tuple(
        ControlPoint(name, PointType.FREE, measures, ignore=name == "D", chooser_name="auto", reference=0)
        for name in "ABCD"
    )
    return ControlNetwork("net", "MARS", points, description="of a test", created="2001-01-01T00:00:00")


def test_a_network_is_kept_but_for_the_marks_of_rejected_points() -> None:
    network = record()
    ties = tie_points(network)
    kept = ignore_rejected(network, ties, Verdicts("v", {"B": Verdict.REJECT}, network=network_digest(ties)))
    assert [point.ignore for point in kept.points] == [False, True, False, True]
    assert tie_points(kept).ids == ("A", "C")
    again = ControlNetwork(**{
        name: tuple(type(point)(**{f: getattr(point, f) for f in point.__struct_fields__} | {"ignore": point.id == "D"})
                    for point in kept.points) if name == "points" else getattr(kept, name)
        for name in kept.__struct_fields__
    })  # fmt: skip
    assert again == network


@pytest.mark.parametrize("suffix", [".pvl", ".net", ".csv"])
def test_kept_networks_are_written(tmp_path: Path, suffix: str) -> None:
    from mgsgraph.files.networks.binary import read_network
    from mgsgraph.files.networks.pvl import write_pvl_network
    from mgsgraph.files.networks.table import read_table, table_text

    given = tmp_path / f"given{'.csv' if suffix == '.csv' else '.pvl'}"
    if suffix == ".csv":
        given.write_text(table_text(record()), encoding="utf-8")
    else:
        write_pvl_network(record(), given)
    out = tmp_path / f"kept{suffix}"
    verdicts = read_verdicts(written(tmp_path / "v.csv", "id,verdict\nC,reject\nA,accept\n"))
    assert write_kept(given, verdicts, out) == (2, 4)
    found = (read_table if suffix == ".csv" else read_network)(out)
    assert [point.id for point in found.points if point.ignore] == ["C", "D"]
    assert found.points[0].measures[0].chooser_name == ("" if suffix == ".csv" else "me")
    with pytest.raises(InputError, match="the network that was reviewed"):
        write_kept(given, verdicts, given)
    if suffix == ".pvl":
        with pytest.raises(InputError, match="a table"):
            write_kept(given, verdicts, tmp_path / "kept.csv")
    assert write_kept(given, verdicts, out) == (2, 4)  # over an earlier one
    out.write_text("years of work")
    with pytest.raises(InputError, match=r"kept.*: exists and is not a"):
        write_kept(given, verdicts, out)
    assert out.read_text() == "years of work"


@pytest.mark.parametrize("suffix", [".pvl", ".net", ".csv"])
def test_a_table_is_kept_with_what_only_the_case_says(tmp_path: Path, suffix: str) -> None:
    """Without a body's name ISIS takes no network, and heights mean nothing without an ellipsoid."""
    from mgsgraph.export.exchange import ExchangeSetting
    from mgsgraph.files.networks.binary import read_network
    from mgsgraph.files.networks.table import read_table
    from mgsgraph.geometry.body import Ellipsoid

    header = "id,image,isis_line,isis_sample,longitude_deg,geodetic_latitude_deg,height_m\n"
    given = written(tmp_path / "given.csv", header + "A,one,1,1,0,0,10\nB,one,2,2,,,\n")
    verdicts, out = read_verdicts(written(tmp_path / "v.csv", "id,verdict\nB,reject\n")), tmp_path / f"kept{suffix}"
    with pytest.raises(InputError, match="a height above an unknown ellipsoid"):
        write_kept(given, verdicts, out)
    setting = ExchangeSetting(target="MARS", ellipsoid=Ellipsoid(3396190.0, 3376200.0))
    assert write_kept(given, verdicts, out, setting) == (1, 2)
    found = (read_table if suffix == ".csv" else read_network)(out)
    assert found.target_name == ("" if suffix == ".csv" else "MARS")
    assert found.points[0].apriori == pytest.approx((3396200.0, 0.0, 0.0))


def test_verdicts_of_a_case_that_holds_some_of_the_images(tmp_path: Path) -> None:
    from mgsgraph.case.assembly import in_images
    from mgsgraph.files.networks.pvl import write_pvl_network

    seen = tuple(ControlMeasure(f"SIM/{name}", MeasureType.MANUAL, 1.0, 1.0) for name in "XY")
    more = ControlPoint("E", PointType.FREE, seen)
    network = ControlNetwork("net", "MARS", (*record().points, more))
    reviewed, note = in_images(tie_points(network), ["SIM/A"])
    assert note
    write_pvl_network(network, tmp_path / "given.pvl")
    verdicts = Verdicts("v", {"B": Verdict.REJECT}, network=network_digest(reviewed))

    with pytest.raises(InputError, match="verdicts about network"):
        write_kept(tmp_path / "given.pvl", verdicts, tmp_path / "kept.pvl")
    assert write_kept(tmp_path / "given.pvl", verdicts, tmp_path / "kept.pvl", images=lambda: ["SIM/A"]) == (2, 5)


# --- in a browser


class Opened:
    """The page in a browser of its own, with what it complained of and asked for."""

    def __init__(self, browser: Any, page: Path, **settings: Any) -> None:
        self.context = browser.new_context(offline=True, accept_downloads=True, **settings)
        self.open(page)

    def open(self, page: Path) -> None:
        self.said, self.asked = list[str](), list[str]()
        self.tab = self.context.new_page()
        self.tab.on("console", lambda message: self.said.append(message.text))
        self.tab.on("pageerror", lambda error: self.said.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(page.as_uri())

    def press(self, keys: str) -> None:
        for key in keys.split():
            self.tab.keyboard.press(key)

    @property
    def focused(self) -> str:
        return str(self.tab.evaluate("document.activeElement.closest('article')?.dataset.id ?? ''"))

    @property
    def order(self) -> list[str]:
        """Ids that can be seen, in their order."""
        seen = "[...document.querySelectorAll('article')].filter(row => !row.hidden).map(row => row.dataset.id)"
        return list(self.tab.evaluate(seen))

    @property
    def counter(self) -> str:
        return str(self.tab.inner_text("#counter"))

    def save(self, path: Path) -> Path:
        with self.tab.expect_download() as download:
            self.tab.click("#save")
        assert download.value.suggested_filename == "verdicts.csv"
        download.value.save_as(path)
        return path


def test_keys_give_verdicts_that_are_read_back(browser: Any, page: Path, tmp_path: Path) -> None:
    seen = Opened(browser, page, viewport={"width": 1280, "height": 800})
    seen.press("j")
    assert seen.focused == "P0"
    seen.press("a")
    assert seen.focused == "P1"
    seen.press("ArrowRight r k k")
    assert seen.focused == "P1"
    seen.press("r k u n")
    seen.tab.keyboard.type('a, "quoted" j')  # letters of a note are no commands
    seen.press("Enter ArrowDown ArrowDown ArrowUp")
    assert seen.focused == "P2"
    assert seen.counter == "1 accepted, 1 rejected, 10 undecided; 12 of 12 shown; not saved to a file yet"
    found = read_verdicts(seen.save(tmp_path / "v.csv"))
    assert found.of == {f"P{i}": "undecided" for i in range(12)} | {"P0": "accept", "P2": "reject"}
    assert found.notes == {"P1": 'a, "quoted" j'}
    assert apply_verdicts(TIES, found).ids == tuple(name for name in TIES.ids if name != "P2")
    assert "not saved" not in seen.counter
    assert seen.said == []
    assert {url for url in seen.asked if not url.startswith(("data:", "blob:"))} == {page.as_uri()}

    seen.open(page)  # the browser has kept them
    assert seen.counter.startswith("1 accepted, 1 rejected, 10 undecided")
    assert seen.tab.input_value("article[data-id=P1] input") == 'a, "quoted" j'


def test_sorting_and_filters(browser: Any, page: Path) -> None:
    seen = Opened(browser, page)
    found = made()
    seen.tab.select_option("#sort", "correlation")
    assert seen.order[0] == "P2"
    assert seen.order == [TIES.ids[i] for i in np.argsort(found.figures["correlation"])]
    seen.tab.select_option("#sort", "misfit")
    assert seen.order == [TIES.ids[i] for i in np.argsort(-found.figures["misfit"], kind="stable")]
    seen.tab.select_option("#sort", "id")
    assert seen.order == [f"P{i}" for i in range(12)]  # P10 after P9
    seen.tab.select_option("#filter", "undecided")
    seen.tab.click("h1")
    seen.press("j j j r")
    assert seen.focused == "P3"
    assert "P2" not in seen.order
    assert "11 of 12 shown" in seen.counter
    seen.tab.select_option("#filter", "reject")
    assert seen.order == ["P2"]
    seen.tab.click("article[data-id=P2] button[value=accept]")
    assert seen.order == []
    seen.tab.select_option("#filter", "")
    assert seen.tab.get_attribute("article[data-id=P2] button[value=accept]", "aria-pressed") == "true"
    assert seen.said == []


@pytest.mark.parametrize(("width", "scheme"), [(380, "dark"), (1280, "light")])
def test_it_fits_and_can_be_read(browser: Any, page: Path, width: int, scheme: str) -> None:
    """No sideways scrolling, chips twofold and sharp, and a contrast of text of 4.5 at least (WCAG 2.2, 1.4.3)."""
    seen = Opened(browser, page, viewport={"width": width, "height": 800}, color_scheme=scheme)
    seen.press("j a r")
    assert seen.tab.evaluate("document.documentElement.scrollWidth") <= width
    assert seen.tab.evaluate("""[...document.querySelectorAll('article *')].every(one =>
        one.getBoundingClientRect().right <= one.closest('article').getBoundingClientRect().right + 1)""")
    assert seen.tab.evaluate("[...document.images].map(one => one.clientWidth)") == [162] * 24
    assert seen.tab.evaluate("getComputedStyle(document.images[0]).imageRendering") == "pixelated"
    assert seen.tab.evaluate(CONTRAST) == []
    assert seen.tab.evaluate("parseFloat(getComputedStyle(document.activeElement).outlineWidth)") >= 2


def test_earlier_verdicts_begin_a_page_and_none_are_lost(browser: Any, tmp_path: Path) -> None:
    earlier = Verdicts("v", {"P2": Verdict.REJECT, "P7": Verdict.ACCEPT, "P8": Verdict.REJECT}, {"P8": "off"},
                       network_digest(TIES))  # fmt: skip
    write_review(made(points=("P2", "P3")), tmp_path / "p.html", earlier)
    seen = Opened(browser, tmp_path / "p.html")
    assert seen.counter.startswith("0 accepted, 1 rejected, 1 undecided")
    seen.tab.click("article[data-id=P2] button[value=undecided]")
    found = read_verdicts(seen.save(tmp_path / "v.csv"))
    assert found.of == {"P2": "undecided", "P3": "undecided", "P7": "accept", "P8": "reject"}
    assert found.notes == {"P8": "off"}
    assert found.network == network_digest(TIES)


def test_without_a_store_it_says_so(browser: Any, page: Path) -> None:
    seen = Opened(browser, page)
    seen.tab.add_init_script("Object.defineProperty(window, 'localStorage', { get() { throw new Error('no'); } });")
    seen.tab.reload()
    assert "save them before you close" in seen.tab.inner_text("#warning")
    seen.press("j a")
    assert seen.counter.startswith("1 accepted")
    assert seen.said == []
