"""What the studies of this folder share: command lines, progress, exit status, pages in Markdown, bands of a mean."""

import argparse
import json
import math
import os
import platform
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any, NoReturn

from mgsgraph.errors import InputError, MgsgraphError
from mgsgraph.files.writing import fresh_file

DOCS = Path(__file__).resolve().parents[1] / "docs"
"""Folder of the pages, where no other is named."""
REMEDY = "choose a file where you may write"
Z99 = NormalDist().inv_cdf(0.995)
"""Quantile of the normal distribution, 99 % two-sided."""

# --- the command line


class OneLine(argparse.ArgumentParser):
    """A command line whose errors are one line each."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")


def command(description: str | None, name: str | None = None) -> OneLine:
    """A command line, called by its name or the script's; its help is the description as it stands."""
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


def write_page(parser: OneLine, path: Path | None, make: Callable[[], str]) -> int:
    """Make a page, print it and write it to a file, if one is named; the exit status. Whether the file can be written
    is asked first.
    """

    def job() -> None:
        require_writable(path)
        text = make()
        show("")
        print(text)
        if path is not None:
            write_text(text, path)

    return status(parser.prog, job)


# --- files


def require_writable(*paths: Path | None) -> None:
    """Raise InputError unless files can be written here; to be asked before long work."""
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
    """Write figures as JSON, whole or not at all."""
    write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file, whole or not at all."""
    with fresh_file(path, remedy=REMEDY) as aside:
        aside.write_text(text, encoding="utf-8")


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure of matplotlib as PNG, whole or not at all."""
    with fresh_file(path, remedy=REMEDY) as aside:
        figure.savefig(aside, dpi=110, format="png")


# --- draws of simulated sites

Draw = dict[str, Any]
"""What one draw gave, as JSON has it: site, seed and figures; or why the draw is no case (`refused`)."""


def kept(path: Path | None) -> dict[tuple[str, int], Draw]:
    """Draws of an earlier run, by site and seed."""
    if path is None or not path.exists():
        return {}
    lines = path.read_text(encoding="utf-8").splitlines()
    return {(draw["site"], draw["seed"]): draw for draw in map(json.loads, lines)}


def note(path: Path | None, draw: Draw) -> None:
    """Add a draw to those kept."""
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(draw) + "\n")


def draws(sites: Sequence[str], seeds: Sequence[int], one: Callable[[str, int], Draw], keep: Path | None) -> list[Draw]:
    """Draws of all sites and seeds; those of an earlier run that are kept in a file are not made again."""
    found = kept(keep)
    for seed in seeds:
        for site in sites:
            if (site, seed) not in found:
                show(f"{site}, seed {seed}")
                found[site, seed] = {"site": site, "seed": seed} | one(site, seed)
                note(keep, found[site, seed])
    return [found[site, seed] for site in sites for seed in seeds]


def cases(every: Sequence[Draw], site: str) -> list[Draw]:
    """Draws of a site that are cases."""
    return [draw for draw in every if draw["site"] == site and "refused" not in draw]


def refusals(every: Sequence[Draw]) -> str:
    """A sentence on draws that are no cases."""
    count = sum("refused" in draw for draw in every)
    return f"Of {len(every)} draws {count} are no cases: a profile is drawn so far off that it misses its image."


# --- Markdown


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    return ["| " + " | ".join(head) + " |", "|---" * len(head) + "|", *("| " + " | ".join(row) + " |" for row in rows)]


def number(value: float) -> str:
    """Three digits; a dash for none."""
    return "-" if math.isnan(value) else f"{value:#.3g}".rstrip(".")


def made_with() -> str:
    """The programs that a page was made with, and their versions."""
    from mgsgraph.adjustment.adjust import versions  # the kernel: not before --threads count

    return f"Made with {', '.join(f'{name} {version}' for name, version in versions().items())}."


def machine() -> str:
    """The processor that a page was made on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0]}, {len(names)} processors" if names else platform.machine()


# --- 99 % bands


def chi_square_band(degrees: int) -> tuple[float, float]:
    """99 % band of a chi-square variable over its degrees of freedom."""
    from scipy.stats import chi2

    low, high = (chi2.ppf([0.005, 0.995], degrees) / degrees).tolist()
    return low, high


def student(chance: float, degrees: int) -> float:
    """Student's quantile beyond which, two-sided, lies a chance."""
    from scipy.stats import t

    return float(t.isf(0.5 * chance, degrees))


def within(mean: float, band: tuple[float, float]) -> str:
    """A mean and its band, and a word where it falls outside; a dash for NaN."""
    if math.isnan(mean):
        return "-"
    low, high = band
    return f"{mean:.3f} ({low:.3f} .. {high:.3f}){'' if low <= mean <= high else ' **outside**'}"
