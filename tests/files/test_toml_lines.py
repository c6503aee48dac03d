"""Lines of keys: TOML of every form against where its keys were written."""

import pytest

from mgsgraph.files.decoding import line_of

TEXT = '''# images = 1
format = 1 # [ties]
name = """
[[images]]
a = 2
"""
dotted . "quo.ted" . 'key' = { inner = [ { deep = 1 }, { deep = 2,
  } ] } # an inline table over two lines, as TOML 1.1 has it
when = 1979-05-27 07:32:00

[[images]]
name = "A # no comment"
orientation.degree = 2
list = [
    1, # one
    [2, 3],
    "four, five",
]

[[images]]
name = 'B'
[images.orientation]
degree = 3
[[images.parts]]
k = 1
[[images.parts]]
k = 2

[solver.deep.er]
loss = "none"
'''
WANTED = {
    ("format",): 2, ("name",): 3, ("dotted", "quo.ted", "key", "inner", 1, "deep"): 7, ("when",): 9,
    ("images", 0): 11, ("images", 0, "name"): 12, ("images", 0, "orientation", "degree"): 13,
    ("images", 0, "list", 1, 1): 14, ("images", 0, "list", 2): 14, ("images", 1): 20, ("images", 1, "name"): 21,
    ("images", 1, "orientation"): 22, ("images", 1, "orientation", "degree"): 23, ("images", 1, "parts", 0, "k"): 25,
    ("images", 1, "parts", 1): 26, ("images", 1, "parts", 1, "k"): 27, ("solver", "deep"): 29,
    ("solver", "deep", "er", "loss"): 30,
}  # fmt: skip


@pytest.mark.parametrize("place", WANTED, ids=str)
def test_lines_are_where_keys_stand(place: tuple[str | int, ...]) -> None:
    assert line_of(TEXT, place) == WANTED[place]


def test_the_innermost_table_stands_for_what_is_not_there() -> None:
    assert line_of(TEXT, ["images", 1, "held"]) == 20
    assert line_of(TEXT, ["nothing", 3]) is None
