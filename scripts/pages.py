"""Write what pages say of the program itself, as plain text that reads everywhere: every verb with its options
(docs/commands.md), every table and key of a case file (docs/case_file.md), every column of the results and every array
of a solution.npz (docs/files.md), every key of input files that bears on geometry (docs/input_keys.md): the meaning of
an array is what its field in the source says.

`python scripts/pages.py` writes them; a test (tests/test_docs.py) holds them true.
"""

import inspect
import re
import tempfile
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

import click
import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.checkpoints import leave_out
from mgsgraph.analysis.components import components
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import reliability
from mgsgraph.analysis.residual_spectrum import ResidualVibrations
from mgsgraph.analysis.statistics import solution_connectivity
from mgsgraph.analysis.unexplained import unexplained
from mgsgraph.case.case_file import key_tables
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.cli import group
from mgsgraph.cli.verbs import VERBS
from mgsgraph.files.geometric_keys import FORMATS, Use
from mgsgraph.files.output.table import Column, Table
from mgsgraph.geometry.stereo_surface import SurfaceHeights
from mgsgraph.network import PointClass
from mgsgraph.record import meanings
from mgsgraph.registration.case import CaseRegistration, register_case
from mgsgraph.registration.dem.checking import HeightChecks
from mgsgraph.registration.minima import CostSurface, ProfileState, ReliefProfile
from mgsgraph.results.analysis import (
    components_table,
    likelihood_table,
    reliability_table,
    unexplained_table,
    vibrations_table,
)
from mgsgraph.results.archive import FORMAT, array_scalar, kinds_of
from mgsgraph.results.ground import discrepancies_table
from mgsgraph.results.matching import matches_table
from mgsgraph.results.passes import nodes_table, shared_table
from mgsgraph.results.places import selection_table
from mgsgraph.results.plan import evaluations_table
from mgsgraph.results.registration import discrepancy_table, registration_table
from mgsgraph.results.relief import profiles_table, relief_shots_table
from mgsgraph.results.tables import connectivity_table, orientation_table, points_table, residuals_table
from mgsgraph.results.terrain_model import shots_table
from mgsgraph.results.verdict import drivers_table
from mgsgraph.simulation.demo.demonstration import disagreement_table
from mgsgraph.simulation.files import write_pair, write_site
from mgsgraph.simulation.orbit import MARS
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.simulation.site import SimulationOptions, simulate_site

DOCS = Path(__file__).resolve().parents[1] / "docs"
_COMMANDS = """<!-- written by scripts/pages.py -->
# Commands

For users of the command line: every verb with its options, as `mgsgraph VERB --help` says it. This page is made from
the commands themselves. Exit status: 0 done (an adjustment is valid or suspect), 1 invalid or not converged (results
are written), 2 bad input (one line on standard error), 130 interrupted. Output is atomic: an earlier result is
replaced only when the new one is complete; a folder with anything else in it is refused. Without `--out` results lie
in the working directory, in NAME-VERB: NAME is that of the case file or result (of a `case.toml` that of its folder).
An image is named by any unique part of its name.
"""
_INPUT_KEYS = """<!-- written by scripts/pages.py -->
# Keys of input files

For users who ask which keys of their files determine the geometry. The tables list these keys by format. A key is
*read*, *compared* with a second statement of the same fact, or *refused* if it differs from the last column (convert
the file first). `mgsgraph check` names a key that looks geometric and is not listed. A key without a second statement
stays unchecked: `mgsgraph check CASE --details` prints the values of those that determine the geometry. This page is
made from `mgsgraph/files/geometric_keys.toml`, which the readers use. Names are regular expressions.
"""
_KEYS = "<!-- keys: written by scripts/pages.py -->\n"
_LIES = "\n## Lies"
_COLUMNS = "<!-- columns: written by scripts/pages.py -->\n"


def pages() -> dict[Path, str]:
    """Expected text of each page."""
    return {
        DOCS / "commands.md": _COMMANDS + commands_markdown(),
        DOCS / "case_file.md": f"{_before_mark('case_file.md', _KEYS)}\n{keys_markdown()}",
        DOCS / "files.md": "\n".join([_before_mark("files.md", _COLUMNS) + columns_markdown(), *array_tables()]) + "\n",
        DOCS / "input_keys.md": _INPUT_KEYS + input_keys_markdown() + _after_mark("input_keys.md", _LIES),
    }


def _before_mark(page: str, mark: str) -> str:
    """Text of a page down to the mark."""
    return "".join((DOCS / page).read_text(encoding="utf-8").partition(mark)[:2])


def _after_mark(page: str, mark: str) -> str:
    """The part of a page from the mark on."""
    return "".join((DOCS / page).read_text(encoding="utf-8").partition(mark)[1:])


def keys_markdown() -> str:
    """Tables and keys of a case file as sections of a page, a heading and a list for each table."""
    lines: list[str] = []
    for table in key_tables():
        head = f"`{table.head}`" if table.path else table.head
        lines += [f"### {head}", "", table.meaning, "", "| key | what it is | when left out | what it says |"]
        lines.append("|---|---|---|---|")
        for key in table.keys:
            default = "**must be there**" if key.required else f"`{key.default}`" if key.default else ""
            kind = key.kind.replace('"', "`")
            cells = f"`{key.name}`", kind, default, key.meaning.replace("|", r"\|")
            lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
        lines.append("")
    return "\n".join(lines)


def input_keys_markdown() -> str:
    """A table for each format, and the keys that could not be compared."""
    lines: list[str] = []
    for name, keys in FORMATS.items():
        lines += ["", f"## {name[0].upper()}{name[1:]}", ""]
        lines += ["| key | use | meaning | held against |", "|---|---|---|---|"]
        lines += [f"| `{_cell(key.name)}` | {key.use} | {_cell(key.meaning)} | {_cell(key.same_as)} |" for key in keys]
        alone = [f"`{_cell(key.name)}`" for key in keys if key.use == Use.READ and not key.same_as]
        lines += ["", f"Without a second statement: {', '.join(alone)}."] if alone else []
    return "\n".join(lines) + "\n"


def commands_markdown() -> str:
    """A section for each verb."""
    lines: list[str] = []
    with click.Context(group, info_name="mgsgraph") as context:
        for name in VERBS:
            command: click.Command | None = group
            for word in name.split():
                assert isinstance(command, click.Group)
                command = command.get_command(context, word)
            assert command is not None
            lines += _verb(name, command, context)
    return "\n".join(lines) + "\n"


def _verb(name: str, command: click.Command, parent: click.Context) -> list[str]:
    with click.Context(command, info_name=name, parent=parent) as ctx:
        usage = command.collect_usage_pieces(ctx)
        options = [record for parameter in command.params if (record := parameter.get_help_record(ctx)) and record[1]]
    lines = ["", f"## `mgsgraph {name}`", "", f"`mgsgraph {name} {' '.join(usage)}`"]
    lines += ["", *_marked(inspect.cleandoc(command.help or "")).splitlines(), ""]
    if options:
        lines += ["| option | what it does |", "|---|---|"]
    return lines + [f"| `{_cell(option)}` | {_cell(_marked(meaning))} |" for option, meaning in options]


def _marked(text: str) -> str:
    """Options as code, pages as links."""
    text = re.sub(r"(?<![`\w-])(--[a-z][a-z-]*)", r"`\1`", text.replace("\b\n", ""))
    return re.sub(r"\bdocs/(\w+)\.md\b", r"[\1](\1.md)", text)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


# --- columns of the results

_MORE = """
[[shared]]
kind = "range bias"
sigma_m = 5.0

[[passes]]
name = "A"
images = ["SIM/A"]
prior = {}

[solver]
reject = 4.0
"""
"""Options of a small simulated case in which every table has rows."""


def columns_markdown() -> str:
    """A section for each file."""
    return "\n".join(line for file, table in _tables() for line in _section(file, table)) + "\n"


def _solution() -> Solution:
    with tempfile.TemporaryDirectory() as folder:
        case = write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), Path(folder))
        case.write_text(case.read_text(encoding="utf-8") + _MORE, encoding="utf-8")
        return adjust(read_case(case))


def _tables() -> Iterator[tuple[str, Table]]:
    solution = _solution()
    linearised = Posterior.of(solution).linearised
    yield "points.csv", points_table(solution)
    yield "orientation.csv", orientation_table(solution)
    yield "residuals.csv", residuals_table(solution)
    yield "connectivity.csv", connectivity_table(solution_connectivity(solution))
    yield "shared.csv", shared_table(solution)
    yield "passes.csv", nodes_table(solution)
    yield "drivers.csv", drivers_table(solution)
    left_out = leave_out(linearised)
    yield "checkpoints.csv", discrepancies_table("checkpoints", left_out, solution.network)
    yield "leave_out.csv", discrepancies_table("leave_out", left_out, solution.network)
    yield "reliability.csv", reliability_table(reliability(linearised))
    yield "unexplained.csv", unexplained_table(unexplained(linearised))
    yield "vibrations.csv", vibrations_table(ResidualVibrations((), ()))
    yield "components.csv", components_table(components(linearised))
    yield "likelihood.csv", likelihood_table(())
    registration = _registration()
    yield "registration.csv", registration_table(registration)
    yield "discrepancy.csv", discrepancy_table(registration)
    yield "what mgsgraph footprints writes", selection_table(registration.before[0].footprints)
    yield from _without_rows()


def _registration() -> CaseRegistration:
    with tempfile.TemporaryDirectory() as folder:
        site = simulate_site("gusev", 1, SimulationOptions(pictures=False))
        return register_case(read_case(write_site(site, Path(folder))))


def _without_rows() -> Iterator[tuple[str, Table]]:
    """Tables whose columns are the same without a plan, a match or a laser shot."""
    none, pairs, index = np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=np.int64)
    ties = SimpleNamespace(ids=(), measure_point=index, measure_image=(), measures=pairs, measure_sigmas=pairs)
    covariances, reference = np.zeros((0, 2, 2)), np.zeros(0, dtype=np.bool_)
    matches: Any = SimpleNamespace(
        ties=ties, covariances=covariances, reference=reference, correlation=none, misfit=none
    )
    checks = HeightChecks((), index, (), np.zeros((0, 3)), pairs, none, none, none, none)
    dem: Any = SimpleNamespace(checks=checks, model=SimpleNamespace(map=SimpleNamespace(radius=0.0)))
    yield "plan.csv", evaluations_table({})
    yield "matches.csv", matches_table(matches)
    yield "shots.csv", shots_table(dem)
    relief = _relief_without_shots()
    yield "profiles.csv", profiles_table(relief)
    yield "shots.csv of coregister", relief_shots_table(relief)
    yield "disagreement.csv", disagreement_table(())


def _relief_without_shots() -> Any:
    """A registration by relief of one profile without shots."""
    none, index, mask = np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    vectors, pairs = np.zeros((0, 3)), np.zeros((0, 2))
    heights = SurfaceHeights(none, vectors, np.zeros((0, 2, 9)), pairs, pairs, mask, none, none, none)
    state = ProfileState(vectors, heights, CostSurface("", np.zeros(1), np.zeros((1, 1)), 0, ()))
    profile = ReliefProfile("", PointClass.LASER, index, mask, none, state, state, np.zeros(2), np.zeros((2, 2)))
    points, shifts = SimpleNamespace(ids=(), places=vectors), SimpleNamespace(sigmas=np.zeros(1))
    network = SimpleNamespace(points=points, body=MARS, shifts=shifts)
    return SimpleNamespace(profiles=(profile,), solution=SimpleNamespace(network=network))


def _section(file: str, table: Table) -> list[str]:
    lines = ["", f"## {file}", "", f"{table.title}. {table.note}".rstrip(), "", "| column | unit | meaning |"]
    return [*lines, "|---|---|---|", *(_row(column) for column in table.columns if column.files)]


def _row(column: Column) -> str:
    names = ", ".join(f"`{part.name()}`" for part in column.split)
    unit = column.unit if isinstance(column.unit, str) else "in `unit`"
    return f"| {names} | {unit} | {column.meaning} |".replace("|  |", "| |")


# --- arrays of a solution.npz

_ARRAY_HEAD = "| array | numbers | unit | meaning |"
GROUPS = ("", "network", "network.images.*", "network.points", "network.rays", "network.ranges", "network.surface",
          "network.passes.*", "network.stereo", "network.crossovers", "joint_covariance")  # fmt: skip
"""Paths of records whose arrays have a table of their own; the longest one counts."""
_SHAPE = re.compile(r"(\([^()]*(?:\([^()]*\))?[^()]*\))[:,]? *")
_UNIT = re.compile(
    r"(m and rad squared|m and rad|1/m and 1/rad|pixels and pixels/m|rad/s|m/s|m\^2|m per m|pixels|rad|m|s)\b"
    r"(?![\w^])[,:;.]? *"
)
_LATER = re.compile(r", (pixels)\b|(m or rad)\b|in the unit (of its kind)")


class ArrayRow(NamedTuple):
    """An array, or several of the same place in the record."""

    path: str
    """With `*` for the numbers of a sequence, or the keys of a mapping."""
    scalars: tuple[str, ...]
    """NumPy's types of the numbers; one of them."""
    shape: str
    unit: str
    meaning: str

    @property
    def group(self) -> str:
        """Group of its table."""
        return max((name for name in GROUPS if not name or self.path.startswith(f"{name}.")), key=len)

    @property
    def line(self) -> str:
        """Its row in the table of its group."""
        name = self.path.removeprefix(f"{self.group}.") if self.group else self.path
        numbers = f"{' or '.join(self.scalars)} {self.shape}"
        return f"| `{name}` | {numbers} | {self.unit} | {self.meaning.replace('|', chr(92) + '|')} |"


def array_rows() -> list[ArrayRow]:
    """All of them, in the order of the record; those of the same name and meaning, once."""
    general = [
        ArrayRow("format", ("int64",), "()", "-", f"Version of this layout: {FORMAT}."),
        ArrayRow("record", ("uint8",), "(b,)", "-",
                 "JSON in UTF-8: all that is no array, and where the arrays belong."),
    ]  # fmt: skip
    merged = dict[tuple[str, str, str, str], list[str]]()
    for path, scalar, text in _walk(Solution, "", ""):
        shape, unit, meaning = _parts(text, scalar)
        scalars = merged.setdefault((path, shape, unit, meaning), [])
        scalars += [scalar] if scalar not in scalars else []
    return [*general, *(ArrayRow(path, tuple(scalars), *rest) for (path, *rest), scalars in merged.items())]


def array_tables() -> list[str]:
    """Markdown: a heading and a table for each group that there is."""
    rows, lines = array_rows(), list[str]()
    for name in GROUPS:
        title = f"Arrays of `{name}`" if name else "Arrays of the solution itself"
        of_group = [row.line for row in rows if row.group == name]
        lines += [f"## {title}", "", _ARRAY_HEAD, "|---|---|---|---|", *of_group, ""]
    return lines[:-1]


def _walk(kind: Any, path: str, text: str) -> Iterator[tuple[str, str, str]]:
    """Path, type and meaning of the arrays in a value of a declared type."""
    origin, options = get_origin(kind), get_args(kind)
    if scalar := array_scalar(kind):
        yield path, scalar.__name__, text
    elif origin in (Union, types.UnionType):
        for member in options:
            if member is not type(None):
                yield from _walk(member, path, text)
    elif origin is tuple and options[0] is str:
        yield path, "str", text
    elif origin is tuple or origin is Mapping:
        yield from _walk(options[0 if origin is tuple else 1], f"{path}.*", text)
    elif is_dataclass(kind) and isinstance(kind, type):
        texts, hints = meanings(kind), get_type_hints(kind)
        for field in fields(kind):
            below = f"{path}.{field.name}" if path else field.name
            yield from _walk(hints[field.name], below, texts.get(field.name, ""))
    else:
        for member in kinds_of(kind):
            yield from _walk(member, path, text)


def _parts(text: str, scalar: str) -> tuple[str, str, str]:
    """Shape, unit and meaning of a field that is described as "(n, 3) m, body-fixed"."""
    shape = _SHAPE.match(text)
    rest = text[shape.end() :] if shape else text
    unit = _UNIT.match(rest) if scalar.startswith("float") else None  # numbers of points and bytes have none
    later = _LATER.search(rest) if scalar.startswith("float") else None
    rest = rest[unit.end() :] if unit else rest
    dimension = unit[1] if unit else later[later.lastindex or 0] if later else "-"
    rest = rest[:1].upper() + rest[1:] if rest else "As the name says."
    return shape[1] if shape else "(i,)", dimension, " ".join(rest.split())


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8", newline="\n")
