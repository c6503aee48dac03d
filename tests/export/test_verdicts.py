"""Verdicts about tie points: what a file says, and what becomes of the network that it is about."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from chip_scene import inner, moved, ties_at
from hypothesis import given, settings
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.errors import InputError
from mgsgraph.export.exchange import Selection, convert
from mgsgraph.export.exchange_setting import ExchangeSetting
from mgsgraph.export.verdicts import (
    Verdict,
    Verdicts,
    apply_verdicts,
    ignore_rejected,
    network_digest,
    read_verdicts,
    verdicts_text,
)
from mgsgraph.files.networks.record import ControlMeasure, ControlNetwork, ControlPoint, MeasureType, PointType
from mgsgraph.files.networks.tie_points import tie_points

TIES = moved(ties_at(inner(12)), np.array([5]), np.array([2.0, -1.5]))
"""P2's second measure is off."""


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


@settings(max_examples=60, deadline=None)
@given(
    of=st.dictionaries(st.text('aé"#, ;1', min_size=1).filter(str.strip), st.sampled_from(Verdict), min_size=1),
    note=st.text('a,"\n#é '),
)
def test_what_is_written_is_read_back(
    of: dict[str, Verdict], note: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    given = Verdicts("v", of, {next(iter(of)): note.strip()} if note.strip() else {}, network_digest(TIES))
    found = read_verdicts(written(tmp_path_factory.mktemp("v") / "v.csv", verdicts_text(given)))
    assert (found.of, found.notes, found.network) == (given.of, given.notes, given.network)


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
    refuses(said, read_verdicts, written(tmp_path / "v.csv", text))


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    refuses("no such file", read_verdicts, tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"id,verdict\n\xff\xfe,accept\n")
    refuses("not UTF-8", read_verdicts, tmp_path / "b.csv")


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
    before, after = (
        {(ties.ids[i], image): place for i, image, place in
         zip(ties.measure_point.tolist(), ties.measure_image, ties.measures.tolist(), strict=True)}
        for ties in (TIES, kept)
    )  # fmt: skip
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
    kept = ignore_rejected(network, Verdicts("v", {"B": Verdict.REJECT}, network=network_digest(ties)))
    assert [point.ignore for point in kept.points] == [False, True, False, True]
    assert tie_points(kept).ids == ("A", "C")
    again = ControlNetwork(**{
        name: tuple(type(point)(**{f: getattr(point, f) for f in point.__struct_fields__} | {"ignore": point.id == "D"})
                    for point in kept.points) if name == "points" else getattr(kept, name)
        for name in kept.__struct_fields__
    })  # fmt: skip
    assert again == network


def kept(given: Path, verdicts: Verdicts, out: Path, setting: ExchangeSetting | None = None) -> str:
    """What is said of the ignored points of a network that is written."""
    return convert(given, out, setting, Selection(verdicts=verdicts)).notes[-1]


@pytest.mark.parametrize("suffix", [".pvl", ".net", ".csv"])
def test_networks_are_written_without_rejected_points(tmp_path: Path, suffix: str) -> None:
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
    assert kept(given, verdicts, out) == "Ignored: 2 of 4 points"
    found = (read_table if suffix == ".csv" else read_network)(out)
    assert [point.id for point in found.points if point.ignore] == ["C", "D"]
    assert found.points[0].measures[0].chooser_name == ("" if suffix == ".csv" else "me")
    refuses("one of the files that are read", kept, given, verdicts, given)
    assert kept(given, verdicts, out) == "Ignored: 2 of 4 points"  # over an earlier one
    out.write_text("years of work")
    refuses(r"kept.*: exists and is not a", kept, given, verdicts, out)
    assert out.read_text() == "years of work"


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

    refuses("verdicts about network", kept, tmp_path / "given.pvl", verdicts, tmp_path / "kept.pvl")
    setting = ExchangeSetting(sizes={"SIM/A": (100, 100)})
    assert kept(tmp_path / "given.pvl", verdicts, tmp_path / "kept.pvl", setting) == "Ignored: 2 of 5 points"
