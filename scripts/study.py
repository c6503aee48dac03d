"""The harness of the studies in this folder: command line, draws of many seeds, bands of the NEES, pages.

A study is a file with its settings, a function that makes one draw, and a judge that makes tables of all draws. Its
section in a page of docs (PAGE#STUDY) is written by hand but for what stands between marks `<!-- made: STUDY NAME -->`
and `<!-- end -->`, which `write_page` fills: the tables, and last (NAME: by) the command, commit, programs and machine.
"""

import argparse
import json
import math
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from mgsgraph.errors import InputError, MgsgraphError, SolverError
from mgsgraph.files.writing import fresh_file
from mgsgraph.geometry.records import Array, Index

if TYPE_CHECKING:
    from mgsgraph.adjustment.solution import Solution

DOCS = Path(__file__).resolve().parents[1] / "docs"
"""Default folder of the pages."""
REMEDY = "choose a file where you may write"
Z99 = NormalDist().inv_cdf(0.995)
"""Quantile of the normal distribution, 99 % two-sided."""
Blocks = Mapping[str, Sequence[str]]
"""Lines of the made parts of a page, by name."""
Draw = dict[str, Any]
"""What one draw gave, as JSON has it: case, seed and figures; or why the draw is no case (`refused`)."""

# --- the command line


class OneLine(argparse.ArgumentParser):
    """A command line whose errors are one line each."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")


def command(description: str | None, name: str | None = None) -> OneLine:
    """A command line, called by its name or the script's; its help is the unchanged description."""
    formatter = argparse.RawDescriptionHelpFormatter
    return OneLine(prog=name or Path(sys.argv[0]).stem, description=description, formatter_class=formatter)


def at_least(least: int) -> Callable[[str], int]:
    """A reader of whole numbers for the command line, `least` or more."""

    def whole_number(text: str) -> int:
        value = int(text) if text.isascii() and text.isdigit() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number of at least {least}")
        return value

    return whole_number


def positive(text: str) -> float:
    """A reader of positive numbers for the command line."""
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text}: expected a positive number")
    return value


def show(text: str) -> None:
    """One line on the terminal that the next one replaces; the empty text clears it."""
    if sys.stderr.isatty():
        print(f"\r{text:60}", end="\r" if not text else "", file=sys.stderr, flush=True)


def status(name: str, job: Callable[[], int | None]) -> int:
    """Exit status of a job: its return value (0 for none), or after one line on stderr 2 for bad input and 130 for an
    interrupt.
    """
    try:
        return job() or 0
    except MgsgraphError as error:
        print(f"{name}: error: {error}", file=sys.stderr)
    except MemoryError:
        print(f"{name}: error: out of memory; choose a smaller size", file=sys.stderr)
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return 130
    return 2


# --- a study


def seeds_of(description: str | None, cases: Sequence[str], seeds: int, page: str) -> OneLine:
    """The command line of a study of many seeds: cases, seeds, workers, draws to keep, page (PAGE#STUDY)."""
    parser = command(description)
    which = f"cases, or words of their names: {'; '.join(cases)}"
    parser.add_argument("--cases", nargs="+", default=cases, metavar="CASE", help=which)
    parser.add_argument("--seeds", type=at_least(2), default=seeds, help=f"draws of each case; {seeds} when absent")
    parser.add_argument("--first", type=at_least(0), default=1, help="first seed")
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument("--processes", type=at_least(1), default=1, help="worker processes on this machine")
    workers.add_argument("--cluster", metavar="PLACE", help="local, local:N or tls://host:port")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="note draws here, and go on where it ended")
    parser.add_argument("--out", type=Path, default=default(page), metavar="FILE", help=f"docs/{page} when absent")
    parser.set_defaults(page=page)
    return parser


def chosen(parser: OneLine, selection: Sequence[str]) -> list[str]:
    """Cases that a command line asks for: by their names, or all with a word in their names."""
    names: Sequence[str] = parser.get_default("cases")
    words = {case: case.replace(",", "").split() for case in names}
    matches = [[word] if word in names else [case for case in names if word in words[case]] for word in selection]
    for word in (word for word, some in zip(selection, matches, strict=True) if not some):
        parser.error(f"no case {word!r}; there are {'; '.join(names)}")
    return list(dict.fromkeys(case for some in matches for case in some))


def run(
    parser: OneLine, one_draw: Callable[[str, int], Draw], judge: Callable[[list[Draw]], Blocks],
    arguments: Sequence[str] | None = None,
) -> int:
    """Make the draws that a command line of `seeds_of` asks for, judge them, write the page; the exit status."""
    options = parser.parse_args(arguments)
    place = options.cluster or (f"local:{options.processes}" if options.processes > 1 else None)
    orders = [(case, options.first + k) for case in chosen(parser, options.cases) for k in range(options.seeds)]
    return write_page(parser, options.out, options.page, lambda: judge(drawn(orders, one_draw, options.keep, place)))


def drawn(
    orders: Sequence[tuple[str, int]], one_draw: Callable[[str, int], Draw], keep: Path | None, place: str | None = None
) -> list[Draw]:
    """Draws of cases and seeds, in this process or at workers; draws stored by an earlier run of this commit are
    used again.
    """
    require_writable(keep)
    this = commit()
    draws = {order: draw for order, draw in stored_draws(keep).items() if draw["commit"] == this}
    due = [order for order in orders if order not in draws]
    for done, draw in enumerate(_work(due, one_draw, place), start=1):
        draws[draw["case"], draw["seed"]] = draw | {"commit": this}
        show(f"{done} of {len(due)}: {draw['case']}, seed {draw['seed']}")
        if keep is not None:
            with keep.open("a", encoding="utf-8") as file:
                file.write(json.dumps(draw | {"commit": this}) + "\n")
    return [draws[order] for order in orders]


def _work(
    orders: Sequence[tuple[str, int]], one_draw: Callable[[str, int], Draw], place: str | None
) -> Iterator[Draw]:
    """Draws as they are finished."""
    if place is None or not orders:
        yield from (_named(one_draw, order) for order in orders)
        return
    from mgsgraph.adjustment.cluster.connection import Lost, open_cluster

    with open_cluster(place, most=len(orders)) as cluster:
        for number, result in cluster.each(partial(_named, _by_name(one_draw)), orders):
            if isinstance(result, Lost):
                raise SolverError("{}, seed {}: {}".format(*orders[number], result.message))
            yield result


def _by_name(job: Any) -> Any:
    """The function as workers import it: from the module of the program's name."""
    return getattr(import_module(Path(sys.argv[0]).stem), job.__name__) if job.__module__ == "__main__" else job


def _named(one_draw: Callable[[str, int], Draw], order: tuple[str, int]) -> Draw:
    return {"case": order[0], "seed": order[1]} | one_draw(*order)


def stored_draws(path: Path | None) -> dict[tuple[str, int], Draw]:
    """Draws of an earlier run, by case and seed; an incomplete last line is removed from the file."""
    if path is None or not path.exists():
        return {}
    try:
        text, _, cut = path.read_text(encoding="utf-8").rpartition("\n")
        draws = {(draw["case"], draw["seed"]): draw for draw in map(json.loads, text.splitlines()) if draw["commit"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(str(path), f"holds no kept draws ({error})", "what --keep has written", REMEDY) from None
    if cut:
        write_text(f"{text}\n" if text else "", path)
    return draws


def cases(draws: Sequence[Draw], case: str) -> list[Draw]:
    """Draws of a case that were not refused."""
    return [draw for draw in draws if draw["case"] == case and "refused" not in draw]


def names_of(draws: Sequence[Draw]) -> list[str]:
    """Cases of draws, each once."""
    return list(dict.fromkeys(draw["case"] for draw in draws))


def refusals(draws: Sequence[Draw]) -> str:
    """A sentence on refused draws."""
    count = sum("refused" in draw for draw in draws)
    return f"Of {len(draws)} draws {count} are no cases: a profile is drawn so far off that it misses its image."


# --- files and pages


def default(page: str) -> Path:
    """The file of PAGE#STUDY in docs."""
    return DOCS / page.partition("#")[0]


def work_and_page(parser: OneLine, page: str) -> None:
    """Options of a study that leaves files, and makes PAGE#STUDY."""
    parser.add_argument("--work", type=Path, help="folder to keep everything in; a temporary one when absent")
    parser.add_argument("--out", type=Path, default=default(page))


def write_page(parser: OneLine, path: Path | None, page: str, make: Callable[[], Blocks]) -> int:
    """Make the blocks of a study (PAGE#STUDY), print them, and write its page to a file, if one is named; the exit
    status. Whether the file can be written is asked first.
    """

    def job() -> None:
        require_writable(path)
        blocks = make()
        show("")
        text = filled(page, {**blocks, "by": [made_by()]})
        print("\n\n".join("\n".join(block).strip() for block in [*blocks.values(), [made_by()]]))
        if path is not None:
            write_text(text, path)

    return status(parser.prog, job)


def filled(page: str, blocks: Blocks) -> str:
    """The text of a page of docs with the made parts of a study (PAGE#STUDY) replaced; InputError where marks of one
    are missing.
    """
    text, study = default(page).read_text(encoding="utf-8"), page.partition("#")[2]
    for name, lines in blocks.items():
        before, begin, rest = text.partition(f"<!-- made: {study} {name} -->\n")
        _, end, after = rest.partition("<!-- end -->")
        if not (begin and end):
            raise InputError(f"docs/{page}", f"no marks of the made part {name!r}", f"{begin} .. <!-- end -->")
        text = "".join([before, begin, "\n", "\n".join(lines).strip(), "\n\n", end, after])
    return text


def require_writable(*paths: Path | None) -> None:
    """Raise InputError unless files can be written; for use before long work."""
    for path in paths:
        if path is None:
            continue
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(str(path), f"can't be written ({error.strerror or error})", remedy=REMEDY) from None
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            raise InputError(str(path), "can't be written", remedy=REMEDY)


def write_json(figures: Any, path: Path) -> None:
    """Write figures as JSON, atomically."""
    write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file, atomically."""
    with fresh_file(path, remedy=REMEDY) as temporary:
        temporary.write_text(text, encoding="utf-8")


# --- Markdown


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    return ["| " + " | ".join(head) + " |", "|---" * len(head) + "|", *("| " + " | ".join(row) + " |" for row in rows)]


def number(value: float) -> str:
    """Three digits; a dash for none."""
    return "-" if math.isnan(value) else f"{value:#.3g}".rstrip(".")


def made_by() -> str:
    """Command, commit, programs and machine of a page."""
    words = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return f"Made by `python scripts/{words}`, commit {commit()}. {machine()}. {made_with()}"


def made_with() -> str:
    """The programs that a page was made with, and their versions."""
    from mgsgraph.adjustment.adjust import versions  # the kernel: not before --threads count

    return f"Made with {', '.join(f'{name} {version}' for name, version in versions().items())}."


def commit() -> str:
    """The commit of this checkout; `dirty` where files differ from it."""
    words = ["git", "-C", str(DOCS), "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def machine() -> str:
    """The processor that a page was made on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0]}, {len(names)} processors" if names else platform.machine()


# --- 99 % bands


def chi_square_band(degrees: float, outside: float = 0.01) -> tuple[float, float]:
    """99 % band of a chi-square variable over its degrees of freedom, or that with another share outside it."""
    from scipy.stats import chi2

    low, high = (chi2.ppf([0.5 * outside, 1.0 - 0.5 * outside], degrees) / degrees).tolist()
    return low, high


def student(chance: float, degrees: int) -> float:
    """Student's quantile beyond which, two-sided, lies a chance."""
    from scipy.stats import t

    return float(t.isf(0.5 * chance, degrees))


def joint_degrees(covariance: Array, width: int) -> float:
    """Degrees of freedom of the chi-square that scatters as the sum of the items' normalised squares does, for items of
    `width` components with a joint covariance (n width, n width) (Satterthwaite 1946): (n width)^2 / |R|^2, R being the
    covariance with each item's own block whitened. n width for independent items, `width` for fully correlated items.
    """
    from scipy.linalg import block_diag

    blocks = np.einsum("iaib->iab", covariance.reshape(-1, width, len(covariance) // width, width))
    whitener = block_diag(*np.linalg.inv(np.linalg.cholesky(blocks)))
    return float(len(covariance) ** 2 / np.sum(np.square(whitener @ covariance @ whitener.T)))


def degrees_of_points(solution: "Solution", points: Index) -> float:
    """The same of the positions of points (n,) of a solution, which share its orientation, without forming their joint
    covariance: with point i = K_i x + N_i e_i (`PointRows.eliminated`), S the covariance of x and C_i that of the point
    |R|^2 = tr (M S M S) + 3 n - sum_i |C_i^-1 K_i S K_i'|^2, M = sum_i K_i' C_i^-1 K_i.
    """
    from mgsgraph.analysis.linearised import at_solution  # the kernel: not before --threads count

    at = at_solution(solution)
    width = at.layout.variables.width
    first, shared = np.cumsum(width) - width, at.joint.of(range(width.size))
    weights, single = np.zeros_like(shared), 0.0
    for i in points.tolist():
        rows = at.rows_of(i)
        carried = rows.eliminated()[0][0]
        columns = np.concatenate([first[v] + np.arange(width[v]) for v in rows.variables])
        by_sigma = np.linalg.solve(np.linalg.cholesky(solution.covariances[i]), carried)
        weights[np.ix_(columns, columns)] += by_sigma.T @ by_sigma
        single += float(np.sum(np.square(by_sigma @ shared[np.ix_(columns, columns)] @ by_sigma.T)))
    product = weights @ shared
    return float((3 * points.size) ** 2 / (np.sum(product * product.T) + 3 * points.size - single))


def nees_band(values: Sequence[float], degrees: float | Sequence[float] = 0.0) -> tuple[float, float]:
    """99 % band of the mean of normalised squares, one of each draw and each per degree of freedom, if the covariances
    are right: a chi-square's for `degrees` in each draw, of a joint covariance or of correlated items
    (`joint_degrees`, `degrees_of_points`); for 0 (unknown), 1 +- Student's quantile times the
    scatter from draw to draw.
    """
    if np.any(degrees):
        return chi_square_band(float(np.mean(degrees)) * len(values))
    half = student(0.01, len(values) - 1) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return 1.0 - half, 1.0 + half


def nees_cell(values: Sequence[float], degrees: float | Sequence[float] = 0.0) -> str:
    """Mean of normalised squares with its band (`nees_band`)."""
    return within(float(np.mean(values)), nees_band(values, degrees))


def within(mean: float, band: tuple[float, float]) -> str:
    """A mean and its band, and a word where it falls outside; a dash for NaN."""
    if math.isnan(mean):
        return "-"
    low, high = band
    return f"{mean:.3f} ({low:.3f} .. {high:.3f}){'' if low <= mean <= high else ' **outside**'}"
