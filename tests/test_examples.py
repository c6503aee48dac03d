"""Every example of the API page and every snippet of the cookbook runs, and prints what stands below it.

Examples stand in the docstrings; what they have at hand is made by the first block of the API page. Numbers with a
decimal point may differ by one in the last place that is shown: they go through other BLAS libraries.
"""

import contextlib
import doctest
import importlib
import inspect
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import mgsgraph

DOCS = Path(__file__).resolve().parents[1] / "docs"
API, COOKBOOK = DOCS / "api.md", DOCS / "cookbook.md"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
LINES = 300
"""Of the images with pixels."""
_NUMBER = re.compile(r"-?\d+(?:\.\d*)?(?:e[+-]?\d+)?")
_BLOCK = re.compile(r"^```(python|output)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


class Rounded(doctest.OutputChecker):
    """Numbers with a decimal point count as the same within one of the last place that is shown."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        if super().check_output(want, got, optionflags):
            return True
        wanted, found = _NUMBER.findall(want), _NUMBER.findall(got)
        if len(wanted) != len(found) or not all(map(_alike, wanted, found)):
            return False
        return super().check_output(_NUMBER.sub("N", want), _NUMBER.sub("N", got), optionflags)


def _alike(wanted: str, found: str) -> bool:
    size, _, power = wanted.partition("e")
    if "." not in size and not power:  # a count
        return wanted == found
    last = 10.0 ** (int(power or 0) - len(size.partition(".")[2]))
    return abs(float(wanted) - float(found)) <= 1.001 * last


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of a page's blocks of Python and of what they print."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))


def public() -> dict[str, Any]:
    """Everything that the API page documents, by its whole name."""
    found = {}
    for name in re.findall(r"^\.\. auto\w+:: (\S+)$", API.read_text(encoding="utf-8"), re.MULTILINE):
        home, _, own = name.rpartition(".")
        found[name] = getattr(importlib.import_module(home), own)
    return found


PUBLIC = public()
SETUP = blocks(API)[0][1]
CLUSTER = "mgsgraph.open_cluster"
"""Starts processes, which under load takes its time."""


@pytest.fixture(scope="module")
def at_hand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Names that the page's first block makes, in a folder of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("examples"))
        names: dict[str, Any] = {}
        exec(compile(SETUP, API.name, "exec"), names)
        yield names


@pytest.fixture(scope="module")
def with_pixels(at_hand: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """And two images with pixels, in the folder `gusev`: `site` as simulated, `mirror` an archive of it."""
    import matched
    from flaky_archive import serving, write_archive

    from mgsgraph.simulation.files import write_site

    site = matched.site(LINES)
    write_site(site, Path("gusev"))
    name, scene = mgsgraph.read_scene("gusev/case.toml")
    settings = mgsgraph.MatchSettings(cells=20, features=1000)
    matches = mgsgraph.match_into(name, scene, Path("matches"), settings, figures=False)
    solution = mgsgraph.adjust(mgsgraph.read_case("gusev/case.toml", ties=Path("matches/network.pvl")))
    coarse = mgsgraph.DemSettings(post=50.0, spacing=30.0)
    dem = mgsgraph.make_dem(solution, "gusev/case.toml", "dem", coarse, figures=False)
    with serving(write_archive(site, Path("archive"))) as address:
        yield at_hand | {"site": site, "matches": matches, "dem": dem, "mirror": mgsgraph.Archives.under(address)}


@pytest.fixture(scope="module")
def with_relief(at_hand: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """And two laser profiles over whole images, registered; dense matches come from the true ground."""
    import relief_site

    registration = relief_site.registration()
    case, before = mgsgraph.read_case(relief_site.case_path()), relief_site.solution()
    with pytest.MonkeyPatch.context() as patch:
        relief_site.use_matches(patch)
        yield at_hand | {"relief": case, "before": before, "registration": registration}


MORE = {
    "with_relief": r"\b(relief|registration)\b(?!\.footprints|\.crossings)",
    "with_pixels": r"\b(gusev|mirror|site|matches|dem)\b",
}
"""What examples say that need more than two simulated images: it costs seconds, and few ask for it."""


def names_for(code: str, request: pytest.FixtureRequest) -> dict[str, Any]:
    """What an example has at hand."""
    fixture = next((name for name, words in MORE.items() if re.search(words, code)), "at_hand")
    return dict(request.getfixturevalue(fixture))


# --- the API page


# above two seconds: a dozen of the examples solve, match or serve an archive
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == CLUSTER else ()) for name in PUBLIC]
)
@pytest.mark.usefixtures("light_figures")
def test_every_public_name_has_an_example_that_runs(name: str, request: pytest.FixtureRequest) -> None:
    text = inspect.getdoc(PUBLIC[name]) or ""
    code = "".join(one.source for one in doctest.DocTestParser().get_examples(text))
    assert code
    test = doctest.DocTestParser().get_doctest(text, names_for(code, request), name, None, 0)
    assert not any(one.options.get(doctest.SKIP) for one in test.examples)
    said: list[str] = []
    doctest.DocTestRunner(Rounded(), verbose=False, optionflags=FLAGS).run(test, out=said.append)
    assert not said, "".join(said)


# --- the cookbook


@pytest.fixture(scope="module")
def cooked(request: pytest.FixtureRequest) -> list[tuple[str, str, str]]:
    """Each snippet with what it should print and what it prints, one after the other, in one session."""
    names, found, parts = dict(request.getfixturevalue("with_pixels")), [], blocks(COOKBOOK)
    for (language, text), (kind, want) in zip(parts[::2], parts[1::2], strict=True):
        assert (language, kind) == ("python", "output"), text
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(text, COOKBOOK.name, "exec"), names)
        found.append((text, want, out.getvalue()))
    return found


# above two seconds: all snippets of the cookbook run, a registration among them
def test_the_cookbook_prints_what_stands_below_each_snippet(cooked: list[tuple[str, str, str]]) -> None:
    assert len(cooked) >= 12
    for text, want, got in cooked:
        assert Rounded().check_output(want, got, FLAGS), f"{text}\nprints\n{got}\nand not\n{want}"
        assert len([line for line in text.splitlines() if line]) <= 12, text
