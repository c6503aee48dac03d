"""The public names are even: records show themselves, what is said in words is a property, things are asked for by name
or number, and help is a page.
"""

import ast
import importlib
import inspect
import pydoc
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from networks import network, pair
from outside import refuses

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.record import Record

PAGE = Path(__file__).resolve().parents[1] / "docs" / "api.md"
PACKAGE = Path(mgsgraph.__file__).parent
NAMED = {"image", "images", "point", "points", "pass", "of_pass", "strip", "shared", "profile", "shift"}
"""Parameters by which one of the network's things is asked for."""


def of_the_page() -> list[Any]:
    """Everything that the API page documents."""
    text, found = PAGE.read_text(encoding="utf-8"), []
    for name in re.findall(r"^\.\. auto(?:class|function|exception):: ([\w.]+)$", text, re.MULTILINE):
        home, _, own = name.rpartition(".")
        found.append(getattr(importlib.import_module(home), own))
    return found


def hints_of(function: Any) -> dict[str, Any]:
    """Types of parameters and result; nothing where one of them is imported for type checkers alone."""
    try:
        return get_type_hints(function)
    except NameError:
        return {}


def classes_in(kind: Any) -> Iterator[type]:
    if inspect.isclass(kind) and kind.__module__.startswith("mgsgraph"):
        yield kind
    for part in get_args(kind):
        yield from classes_in(part)


EVERYTHING = of_the_page()
RECORDS = sorted(
    {
        kind
        for one in EVERYTHING
        for kind in ([one] if inspect.isclass(one) else classes_in(hints_of(one).get("return")))
        if not issubclass(kind, Enum | Exception) and (is_dataclass(kind) or "__init__" in vars(kind))
    },
    key=lambda kind: kind.__qualname__,
)
"""Classes of the page, and what its functions give."""


@pytest.fixture(scope="module")
def solution() -> Solution:
    return adjust_network(network(pair()), SolverSettings())


# --- records


def test_all_public_names_are_looked_at() -> None:
    assert {getattr(mgsgraph, name) for name in mgsgraph.__all__} <= set(EVERYTHING)
    assert len(RECORDS) > 60


@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__qualname__)
def test_every_record_shows_itself(kind: type) -> None:
    assert callable(getattr(kind, "_repr_html_", None))
    assert kind.__repr__ is not object.__repr__
    written = kind.__repr__
    assert not hasattr(written, "__wrapped__"), "@dataclass's, which prints whole arrays"


def test_what_is_said_in_words_is_a_property_of_a_record() -> None:
    said, wrong = list[str](), list[str]()
    for path in sorted(PACKAGE.rglob("*.py")):
        for one in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(one, ast.ClassDef):
                continue
            bases = {ast.unparse(base) for base in one.bases}
            for part in one.body:
                if isinstance(part, ast.FunctionDef) and part.name in ("sentence", "sentences", "words", "statement"):
                    plain = "property" not in map(ast.unparse, part.decorator_list) and len(part.args.args) == 1
                    whole = part.name in ("sentence", "sentences") and not bases & {"Record", "NamedTuple"}
                    (wrong if plain or whole or part.name == "statement" else said).append(f"{one.name}.{part.name}")
    assert not wrong
    assert {"BatchCheck.sentence", "Components.sentences", "Difference.sentence"} <= set(said)


def test_records_of_a_solution_are_brief_and_told_with_their_units(solution: Solution) -> None:
    for record in (solution, solution.network, solution.fit, solution.network.rays, solution.network.images[0]):
        assert len(repr(record)) < 500
        assert "\n" not in repr(record)
        assert record._repr_html_().startswith("<b>")
    shown = solution.network.rays._repr_html_()
    assert f"array{solution.network.rays.places.shape}" in shown
    for field in fields(solution.network.rays):
        assert f"<td>{field.name}</td>" in shown
    assert "<td></td>" not in shown  # a field without a meaning


@dataclass(frozen=True, slots=True)
class Example(Record):
    """Of everything that a field may hold."""

    name: str
    """What <it> is called."""
    values: np.ndarray
    """(n,) m."""
    parts: tuple[object, ...] = ()
    sentence: str = ""


def test_short_values_are_shown_whole_and_long_ones_counted() -> None:
    short = Example("a", np.array([1.0, 2.5]), (1, "b", None))
    assert repr(short) == "Example(name='a', values=[1.0, 2.5], parts=(1, 'b', None), sentence='')"
    assert str(short) == repr(short)
    long = Example("a", np.zeros((40, 3)), tuple(range(40)), "It is long.")
    assert repr(long) == "Example(name='a', values=array(40, 3), parts=tuple of 40, sentence='It is long.')"
    assert str(long) == "It is long."
    within = Example("b", np.zeros(0), (short, {"k": 1.0}, Path("c"), np.float64(2.0)))
    assert "parts=(Example(name='a', values=[1.0, 2.5]" in repr(within)
    assert "{'k': 1.0}, 'c', 2.0)" in repr(within)
    shown = long._repr_html_()
    assert "<li>It is long.</li>" in shown
    assert "<td>What &lt;it&gt; is called.</td>" in shown


# --- names and numbers


def parameters() -> Iterator[Any]:
    for one in EVERYTHING:
        members = [one] if inspect.isfunction(one) else [m for _, m in inspect.getmembers(one, inspect.isfunction)]
        for function in members:
            if not function.__name__.startswith("_"):
                for name in sorted(NAMED & set(inspect.signature(function).parameters)):
                    yield pytest.param(function, name, id=f"{function.__qualname__}-{name}")


@pytest.mark.parametrize(("function", "name"), list(parameters()))
def test_no_parameter_takes_a_number_where_it_takes_no_name(function: Any, name: str) -> None:
    if function.__qualname__ == "SharedUnknown.of":
        return  # it knows no names: its images are numbers of any network
    kind = str(hints_of(function).get(name, ""))
    assert "int" not in re.findall(r"\w+", kind.replace("<class 'int'>", "int")) or "str" in kind


def test_names_and_numbers_give_the_same(solution: Solution) -> None:
    posterior, net = mgsgraph.Posterior.of(solution), solution.network
    for j, image in enumerate(net.image_names):
        assert net.image_number(image) == net.image_number(np.int64(j)) == j
        assert solution.image(image).name == posterior.image(j).name == image
        np.testing.assert_array_equal(solution.correction(image).coefficients, solution.correction(j).coefficients)
        np.testing.assert_array_equal(solution.image_covariance(image), solution.image_covariance(j))
        np.testing.assert_array_equal(solution.correction_covariance(image), solution.correction_covariance(j))
        mine, others = mgsgraph.orientation_profile(solution, image), mgsgraph.orientation_profile(solution, j)
        np.testing.assert_array_equal(mine.position_sigma, others.position_sigma)
        assert repr(posterior.pose(image, 10.0)) == repr(posterior.pose(j, 10.0))
    for i in (0, len(net.points) - 1):
        point = net.points.ids[i]
        assert net.point_number(point) == i
        assert repr(posterior.point(point)) == repr(posterior.point(i))


@pytest.mark.parametrize("asked", ["SIM/AX", -1, 2, 99])
def test_what_is_not_there_is_one_clear_error(solution: Solution, asked: str | int) -> None:
    net, posterior = solution.network, mgsgraph.Posterior.of(solution)
    for ask in (
        net.image_number, solution.correction, solution.image, solution.image_covariance, posterior.image,
        lambda image: mgsgraph.orientation_profile(solution, image), lambda image: posterior.pose(image, 1.0),
    ):  # fmt: skip
        refuses(rf"^image {asked}: .* 2; .*{net.images[0].name}", ask, asked)
    refuses(r"^shared unknown clock: ", solution.shared_covariance, "clock")
    refuses(r"^pass 0: ", net.pictures, 0)


# --- help


def test_help_is_a_page_with_every_public_name() -> None:
    text = inspect.getdoc(mgsgraph) or ""
    listed = re.findall(r"^    (\w+) {2,}\S", text, re.MULTILINE)
    assert sorted(listed) == sorted([*mgsgraph.__all__, "factors"])  # a package of its own
    assert "mgsgraph - " in pydoc.plain(pydoc.render_doc(mgsgraph))
    assert max(map(len, text.splitlines())) <= 120


def test_the_version_is_the_package_s() -> None:
    from importlib.metadata import version

    assert mgsgraph.__version__ == version("mgsgraph")
