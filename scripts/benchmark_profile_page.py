"""What benchmark_profile found, as Markdown tables and a figure."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark_run import write_figure
from benchmark_table import machine, number, table

from mgsgraph.errors import InputError

BEGIN, END = "<!-- profile: begin -->", "<!-- profile: end -->"
"""Marks of a page between which the tables go."""
INNER = ("rows", "normal equations", "factorise", "step")
"""Stages of each inner step; the points go through the others once in a sweep."""
ONCE = ("load", "store", "couple", "pairs", "sums")
FLOPS = ("add", "multiply", "divide", "root")
"""What counts as an operation; comparisons, changes of sign and choices don't."""
WIDTH = "256 bit"
"""Vectors that LLVM chooses for this machine, though it has wider ones."""
WORDS = {
    "load": "constants and places from memory",
    "rows": "residuals and derivatives",
    "normal equations": "3x3 of the point",
    "factorise": "its Cholesky factor",
    "step": "step and its length",
    "store": "places back to memory",
    "couple": "Y = W L^-T of each sight",
    "pairs": "K_ij of each pair of sights",
    "sums": "over lanes, times products of basis values",
}


@dataclass(frozen=True, slots=True)
class Sweep:
    """One sweep of the Levenberg-Marquardt loop."""

    steps: dict[str, float]
    """Inner steps of a point, their mean, by pattern."""
    milliseconds: float
    """With the system, all threads; the least."""
    processor: float
    """ms of the processor, all threads together."""
    alone: float
    """ms of the processor, the same with one thread."""


@dataclass(frozen=True, slots=True)
class Profile:
    """What was measured and counted."""

    problem: str
    threads: int
    repeat: int
    iterations: int
    rays: int
    points: dict[str, int]
    """How many of each pattern."""
    iteration: dict[str, tuple[float, float]]
    """ms of each part of an iteration: the least by the wall's clock, the median of the processor's."""
    afterwards: dict[str, tuple[float, float]]
    """The same of what isn't in every iteration."""
    sweeps: list[Sweep]
    stages: dict[str, dict[str, float]]
    """ns per point by pattern and stage; of `spread`, per pattern."""
    counts: dict[str, dict[str, dict[str, float]]]
    """Operations per point, see `benchmark_stages.counts`."""
    patterns: dict[str, int]
    """How many patterns of each kind there are."""
    held: dict[str, float]
    """Bytes per observation, by array."""
    tile: dict[str, int]
    """Bytes of a tile's registers, by pattern."""
    peaks: dict[str, float]
    """Gflop/s and GB/s, by what and how many threads."""

    def peak(self, name: str) -> tuple[float, float]:
        """Of one thread, and of all."""
        return self.peaks[f"{name}, 1"], self.peaks[f"{name}, {self.threads}"]


def flops(tally: dict[str, float]) -> float:
    """Floating-point operations."""
    return sum(tally.get(kind, 0.0) for kind in FLOPS)


def traffic(tally: dict[str, float]) -> float:
    """Bytes between the tile's registers and the processor."""
    return tally.get("register bytes", 0.0)


def memory(found: Profile, name: str) -> float:
    """Bytes per point that a sweep moves from and to main memory; sums and unknowns stay in the cache."""
    return sum(found.counts[name][stage].get("array bytes", 0.0) for stage in ("load", "store"))


def of_sweep(steps: float, per: dict[str, float]) -> float:
    """Sum over the stages of a sweep, with so many inner steps, of what is given by stage."""
    return sum(per[stage] for stage in ONCE) + steps * sum(per[stage] for stage in INNER)


def typical(found: Profile) -> Sweep:
    """The sweep of the middle by its steps."""
    return sorted(found.sweeps, key=lambda sweep: sum(sweep.steps.values()))[len(found.sweeps) // 2]


def whole_sweep(found: Profile, sweep: Sweep) -> dict[str, float]:
    """Operations, bytes to and from registers, bytes of main memory of a sweep; ns that its stages add up to."""
    total = dict.fromkeys(("flops", "traffic", "memory", "nanoseconds"), 0.0)
    for name, points in found.points.items():
        tallies = found.counts[name]
        per = {
            "flops": {stage: flops(tally) for stage, tally in tallies.items()},
            "traffic": {stage: traffic(tally) for stage, tally in tallies.items()},
            "nanoseconds": found.stages[name],
        }
        for key, values in per.items():
            total[key] += points * of_sweep(sweep.steps[name], values)
        total["flops"] += found.patterns[name] * flops(tallies["spread"])
        total["nanoseconds"] += found.patterns[name] * found.stages[name]["spread"]
        total["memory"] += points * memory(found, name)
    return total


def tables(found: Profile) -> str:
    """All tables."""
    points = ", ".join(f"{count:,} with {name}" for name, count in found.points.items())
    head = (
        f"Problem {found.problem}: {sum(found.points.values()):,} points ({points}), {found.rays:,} image rays; "
        f"{found.iterations} iterations. {machine()}; {found.threads} threads. Of {found.repeat} tries the median of "
        "the processor's time, or the least by the clock on the wall where it says so; peaks are the best. The machine "
        "was shared: compare figures of this page with one another, not with others'."
    )
    parts = [head, "", "### One iteration", "", *iteration_table(found), "", "### Sweeps of the optimisation", ""]
    parts += [*sweep_table(found), "", "### The machine at its best", "", *peak_table(found), ""]
    for name in found.stages:
        parts += [f"### A point with {name}: stages of a sweep", "", *stage_table(found, name), ""]
    parts += ["### The sweep as a whole", "", *whole_table(found), "", "### Memory held", "", *held_table(found), ""]
    return "\n".join(parts)


def iteration_table(found: Profile) -> list[str]:
    """Parts of an iteration, and what comes after the last."""
    wall, total = (sum(pair[k] for pair in found.iteration.values()) for k in range(2))
    rows = [(name, number(least), number(ms), percent(ms / total)) for name, (least, ms) in found.iteration.items()]
    rows += [("**an iteration**", number(wall), number(total), "100 %")]
    rows += [(f"*{name}*", number(least), number(ms), "") for name, (least, ms) in found.afterwards.items()]
    return table(("part", "ms, the least", "ms of the processor, all threads", "share"), rows)


def sweep_table(found: Profile) -> list[str]:
    """Inner steps and time of each sweep."""
    names = tuple(found.points)
    rows = []
    for count, sweep in enumerate(found.sweeps):
        steps = (f"{sweep.steps[name]:.2f}" for name in names)
        added = whole_sweep(found, sweep)["nanoseconds"] * 1e-6
        times = (number(ms) for ms in (sweep.milliseconds, sweep.processor, sweep.alone, added))
        rows.append((str(count), *steps, *times))
    steps = (f"inner steps, {name}" for name in names)
    head = ("sweep", *steps, "ms, the least", "ms of the processor, all threads", "one thread", "its stages added up")
    return table(head, rows)


def peak_table(found: Profile) -> list[str]:
    """What the machine can do."""
    size = max(found.tile.values()) / 1000.0
    rows = []
    for name, words, unit in (
        (WIDTH, f"multiply-adds, {WIDTH}", "Gflop/s"),
        ("512 bit", "multiply-adds, 512 bit", "Gflop/s"),
        ("nearest", "triad in 16 kB (first-level cache)", "GB/s"),
        ("near", f"triad in {size:.0f} kB (second-level cache, the size of a tile)", "GB/s"),
        ("memory", "triad in main memory", "GB/s"),
    ):
        rows.append((words, *(f"{rate:.1f} {unit}" for rate in found.peak(name))))
    return table(("", "one thread", f"{found.threads} threads"), rows)


def stage_table(found: Profile, name: str) -> list[str]:
    """Time, operations and bytes of each stage per point, and shares of the peaks; one thread."""
    rows = []
    peak, near = found.peak(WIDTH)[0], found.peak("near")[0]
    for stage in (*ONCE[:1], *INNER, *ONCE[1:]):
        tally, ns = found.counts[name][stage], found.stages[name][stage]
        work, moved = flops(tally), traffic(tally)
        kinds = " + ".join(f"{tally.get(kind, 0.0):.0f}" for kind in FLOPS)
        accesses = f"{tally.get('register loads', 0.0):.0f} + {tally.get('register stores', 0.0):.0f}"
        cells = (number(ns), kinds, number(work / ns), percent(work / ns / peak), accesses)
        rows.append((f"{stage}: {WORDS[stage]}", *cells, number(moved / ns), percent(moved / ns / near)))
    head = ("stage", "ns", "+, x, /, root", "Gflop/s", "of the peak", "loads + stores", "GB/s", "of the triad")
    return table(head, rows)


def whole_table(found: Profile) -> list[str]:
    """A typical sweep with one thread and with all of them, against the peaks."""
    sweep = typical(found)
    total, points = whole_sweep(found, sweep), sum(found.points.values())
    rows = []
    for name, key, unit, peaks in (
        ("floating-point operations", "flops", "Gflop/s", found.peak(WIDTH)),
        ("bytes to and from registers", "traffic", "GB/s", found.peak("near")),
        ("bytes of main memory", "memory", "GB/s", found.peak("memory")),
    ):
        cells = [name, f"{total[key] / points:,.0f}"]
        for ms, peak in zip((sweep.alone, sweep.milliseconds), peaks, strict=True):
            rate = total[key] * 1e-6 / ms
            cells += [f"{number(rate)} {unit}", percent(rate / peak)]
        rows.append(tuple(cells))
    head = ("", "per point", "one thread", "of the peak", f"{found.threads} threads", "of the peak")
    return table(head, rows)


def held_table(found: Profile) -> list[str]:
    """Bytes per image observation of the kernel's arrays."""
    rows = [(name, f"{size:.0f}") for name, size in found.held.items()]
    return table(("array", "bytes per observation"), [*rows, ("**together**", f"{sum(found.held.values()):.0f}")])


def percent(share: float) -> str:
    """A share in per cent."""
    return f"{100.0 * share:.1f} %" if share < 0.1 else f"{100.0 * share:.0f} %"


def into_page(text: str, path: Path) -> str:
    """A page's text with its tables renewed."""
    try:
        page = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), f"can't be read ({error})", "a page with the marks of its tables") from None
    if page.count(BEGIN) != 1 or page.count(END) != 1 or page.index(BEGIN) > page.index(END):
        raise InputError(str(path), "no place for the tables", f"{BEGIN} and {END}, once each", "put them in")
    return page[: page.index(BEGIN) + len(BEGIN)] + f"\n{text}\n" + page[page.index(END) :]


def draw(found: Profile, path: Path) -> None:
    """Three panels: an iteration, a point's way through a sweep, and shares of the peaks."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 4.6), layout="constrained")
    first, second, third = figure.subplots(1, 3, width_ratios=(1.0, 1.3, 1.2))
    _draw_iteration(first, found)
    _draw_stages(second, found)
    _draw_shares(third, found)
    write_figure(figure, path)


def _draw_iteration(axes: Any, found: Profile) -> None:
    """ms of each part."""
    parts = {**found.iteration, **found.afterwards}
    colours = ["C0"] * len(found.iteration) + ["0.7"] * len(found.afterwards)
    times = [ms for _, ms in parts.values()]
    bars = axes.barh(list(parts), times, color=colours)
    axes.bar_label(bars, [number(ms) for ms in times], padding=2, fontsize=8)
    axes.set(xlabel="ms of the processor, all threads together", xlim=(0.0, 1.2 * max(times)))
    axes.set_title("an iteration (blue), and what it isn't (grey)", fontsize=9)
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=8)


def _draw_stages(axes: Any, found: Profile) -> None:
    """ns per point, stacked, for the steps of a typical sweep."""
    steps, left = typical(found).steps, dict.fromkeys(found.stages, 0.0)
    for count, stage in enumerate(("load", *INNER, *ONCE[1:])):
        times = {name: ns[stage] * (steps[name] if stage in INNER else 1.0) for name, ns in found.stages.items()}
        axes.barh(list(times), list(times.values()), left=list(left.values()), label=stage, color=f"C{count}")
        left = {name: left[name] + ns for name, ns in times.items()}
    for row, name in enumerate(left):
        axes.text(left[name], row, f" {left[name]:.0f}, {steps[name]:.1f} inner steps", va="center", fontsize=8)
    axes.set(xlabel="ns per point, one thread", xlim=(0.0, 1.6 * max(left.values())))
    axes.set_title("a point's way through a sweep", fontsize=9)
    axes.legend(fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    axes.invert_yaxis()


def _draw_shares(axes: Any, found: Profile) -> None:
    """Per cent of the peaks by stage, of two-ray points or whatever comes first."""
    name, stages = next(iter(found.stages)), ("load", *INNER, *ONCE[1:])
    for key, function, peak, shift in (
        ("multiply-adds, 256 bit", flops, found.peak(WIDTH)[0], -0.2),
        ("triad in the second-level cache", traffic, found.peak("near")[0], 0.2),
    ):
        shares = [100.0 * function(found.counts[name][stage]) / found.stages[name][stage] / peak for stage in stages]
        axes.barh([row + shift for row in range(len(stages))], shares, height=0.4, label=key)
    axes.set_yticks(range(len(stages)), stages, fontsize=8)
    axes.set(xlabel=f"% of the measured peak ({name}, one thread)")
    axes.set_title("how near each stage comes to the machine's best", fontsize=9)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    axes.invert_yaxis()

