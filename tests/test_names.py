"""Names in columns: they are the sequences of str that they were made of."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.names import Names, RepeatedNames

NAMES = st.lists(st.text(st.characters(exclude_categories=["Cs"]), max_size=5), max_size=12)


@given(NAMES, st.data())
def test_they_are_the_texts_that_they_were_made_of(texts: list[str], data: st.DataObject) -> None:
    rows = np.array(data.draw(st.lists(st.integers(0, len(texts) - 1), max_size=8)) if texts else [], dtype=np.int64)
    for names in (Names.of(texts), RepeatedNames.of(texts), pickle.loads(pickle.dumps(Names.of(texts)))):
        assert names == texts
        assert tuple(texts) == names
        assert list(names) == names.tolist() == texts
        assert names[rows] == [texts[k] for k in rows.tolist()]
        assert names[np.isin(np.arange(len(texts)), rows)] == [texts[k] for k in np.unique(rows).tolist()]
        assert names[1:] == texts[1:]
        assert [names[k] for k in range(len(texts))] == texts
        assert np.array(names).tolist() == np.array(texts, dtype=str).tolist()  # which drops closing NULs
        assert names.__add__(["x"]) == [*texts, "x"]
        assert ("é" in names) == ("é" in texts)
        assert names.arrow.to_pylist() == texts


@given(NAMES, NAMES)
def test_they_find_each_other(texts: list[str], others: list[str]) -> None:
    known = list(dict.fromkeys(texts))
    expected = [known.index(name) if name in known else -1 for name in others]
    assert Names.of(known).find(others).tolist() == expected
    assert RepeatedNames.of(others).over(known).tolist() == expected
    assert list(RepeatedNames.of(others).used) == list(dict.fromkeys(others))
    assert Names.concatenated([Names.of(texts), Names.of(others)]) == texts + others
    joined = RepeatedNames.concatenated([RepeatedNames.of(texts), RepeatedNames.of(others)])
    assert joined == texts + others


@given(NAMES)
def test_the_first_that_is_there_twice(texts: list[str]) -> None:
    found = [k for k, name in enumerate(texts) if name in texts[:k]]
    assert Names.of(texts).first_repeated == (found[0] if found else None)


def test_names_made_of_numbers() -> None:
    names = Names.joined(np.array([12, 3]), np.array([1, 2]), np.array([0, 7]))
    assert names == ("12:1:0", "3:2:7")
    assert names.prefixed("AP:") == ("AP:12:1:0", "AP:3:2:7")


def test_what_are_no_names() -> None:
    refuses("names: the name", Names.of, ["a\udc80"])
    refuses("don't follow", Names, np.zeros(3, dtype=np.uint8), np.array([0, 2, 1, 3]))
    refuses("numbers up to 1", RepeatedNames, ("a",), np.array([0, 1]))
    with pytest.raises(TypeError):
        Names.of([None])  # type: ignore[list-item]
    with pytest.raises(IndexError):
        Names.of(["a"])[1]


def test_no_question_about_names_loads_pandas() -> None:
    """Where it is installed, a sixth of a second."""
    lines = ["import sys", "import numpy as np", "from mgsgraph.names import Names", "names = Names.of(['a', 'b'])",
             "names.find(['b']), names.containing('b'), names.prefixed('x'), Names.joined(np.arange(2), names.arrow)",
             "assert 'pandas' not in sys.modules"]  # fmt: skip
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True)
