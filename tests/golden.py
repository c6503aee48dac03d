"""Golden results: what the program computes of some cases, kept in `golden_results`, and how two of them are compared.

Only public functions, attributes of a Solution and commands are used here, so that modules may move. `python
scripts/golden.py` compares, and with `--write` makes the files anew.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import numpy as np
from commands import run

import mgsgraph

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).with_name("golden_results")
Result = dict[str, list[Any]]
"""Kind and numbers of each quantity: a count; a cost; estimates and their sigmas; the lower triangle of a covariance;
numbers and their scale, one or each its own."""
TOLERANCES = {"count": 0.5, "cost": 1e-9, "estimate": 1e-6, "covariance": 1e-6, "number": 1e-6}
"""Times the cost; the sigma, of estimates and of sigmas; sqrt(C_ii C_jj); the scale."""
LOOSER = 1e3
"""Other versions of the libraries round differently: iterations may stop elsewhere within their limit, 1e-6 sigmas
mostly, and 2e-4 in a project before `solve`."""
LIBRARIES = ("numpy", "scipy", "gtsam", "numba", "spiceypy")
POINTS, IMAGES, NUMBERS = 40, 3, 6
"""Kept of a solution's points one by one, of its images with their joint covariance, and of each column of a file."""
POSE = 1e-4
"""Scale of numbers in files for other programs, as a share of the largest in a column: places and poses to 1e-10 of it,
0.3 mm, which is some 1e-5 of their sigmas. To 1e-11 other processors differ."""
WHOLE = "sigma|covar|matrix|residual|gsd|swath"
"""Columns whose scale is the largest number itself: sigmas, and what is computed to less."""
DIGIT = 1.1e-2
"""Least scale in ISIS's tables, which have eight decimals. Columns have no names there: all are held as sigmas are."""


@dataclass(frozen=True)
class Golden:
    """One golden result: how it is computed in an empty folder, and what it needs."""

    make: Callable[[Path], Result]
    data: tuple[str, ...] = ()
    """Folders of real data."""
    without: str = ""
    """Regular expression of quantities that rounding changes, which are not kept."""
    reason: str = ""
    """Why it does."""


def of_solution(solution: mgsgraph.Solution) -> Result:
    """Everything by name: a sample of the points, and sums over all of them with signs that their names give."""
    network, sigmas, ids = solution.network, solution.sigmas, list(solution.network.points.ids)
    used = {"rays": solution.rays_used, "ranges": solution.ranges_used, "points": solution.determined}
    found: Result = {name: ["count", int(mask.sum())] for name, mask in used.items()}
    found["degrees of freedom"] = ["count", solution.fit.degrees_of_freedom]
    found["minima"] = ["count", 0 if solution.minima is None else len(solution.minima.each)]
    found["converged"] = ["count", int(solution.converged)]
    found |= {"cost": ["cost", solution.cost_final], "sigma0": ["cost", solution.sigma0]}
    found |= _of_unknowns(solution) | _of_points(ids, solution.places, solution.covariances)
    signs, every = np.array([_sign(one) for one in ids])[:, None], _short(np.sqrt(np.nansum(sigmas**2, axis=0)))
    found["all places"] = ["number", _long(np.nansum(signs * solution.places, axis=0)), every]
    found["all sigmas"] = ["number", _long(np.nansum(signs * sigmas, axis=0)), every]
    classes = network.points.classes[network.rays.point]
    for kind in np.unique(classes).tolist():
        mine = (classes == kind) & solution.rays_used
        found[f"rms of rays of class {int(kind)}"] = _rms((solution.residuals / network.ray_sigmas)[mine])
    if solution.ranges_used.any():
        found["rms of ranges"] = _rms((solution.range_residuals / network.ranges.sigmas)[solution.ranges_used])
    return found


def _of_unknowns(solution: mgsgraph.Solution) -> Result:
    """Orientation and shared unknowns with their sigmas, and the joint covariance of a sample."""
    network, joint = solution.network, solution.joint_covariance
    images = network.image_names
    names = [*images, *network.shift_names, *(one.name for one in network.shared)]
    # factors of errors in common are left out: they turn as eigenvectors may
    names += [f"unknown {k} of passes" for k in range(int(network.first_of_passes[-1]) - len(names))]
    variances = [np.diagonal(joint.block(k, k)) for k in range(len(names))]
    free = {name: k for k, name in enumerate(names) if variances[k].any()}
    sample = [*_spread(sorted(set(images) & set(free)), IMAGES), *_spread(sorted(set(free) - set(images)), IMAGES)]
    found: Result = {
        name: ["estimate", _long(value), _short(np.sqrt(variance))]
        for name, value, variance in zip(names, solution.values, variances, strict=False)
    }
    return found | {f"covariance of {', '.join(sample)}": _covariance(joint.of([free[name] for name in sample]))}


def _of_points(ids: Sequence[str], places: np.ndarray, covariances: np.ndarray) -> Result:
    found: Result = {}
    for i in _spread(sorted(range(len(ids)), key=ids.__getitem__), POINTS):
        found[ids[i]] = ["estimate", _long(places[i]), _short(np.sqrt(np.diagonal(covariances[i])))]
        found[f"covariance of {ids[i]}"] = _covariance(covariances[i])
    return found


def _covariance(matrix: np.ndarray) -> list[Any]:
    return ["covariance", _short(matrix[np.tril_indices(len(matrix))])]


def _rms(residuals: np.ndarray) -> list[Any]:
    """Of residuals in sigmas of the measurements."""
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    return ["number", _long(rms), _short(np.maximum(rms, 1.0))]


def _spread(items: Sequence[Any], most: int) -> list[Any]:
    """At most so many of them, evenly spaced, the first and the last among them."""
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))]


def _sign(name: object) -> float:
    return 1.0 - 2.0 * (crc32(str(name).encode()) & 1)


def _long(values: Any) -> list[float]:
    return [float(one) for one in np.ravel(values)]


def _short(values: Any) -> list[float]:
    return [float(f"{one:.11g}") for one in np.ravel(values)]


def of_columns(columns: Mapping[str, Sequence[float]], share: float = 1.0, least: float = 0.0) -> Result:
    """Some numbers of each column, and the sum of all with signs that their places give."""
    found: Result = {}
    for name, column in columns.items():
        values = np.array(column)
        largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
        scale = max(float(f"{largest * (1.0 if re.search(WHOLE, name, re.IGNORECASE) else share):.3g}"), least)
        found[f"number of {name}"] = ["count", values.size]
        found[name] = ["number", _long(_spread(values, NUMBERS)), scale]
        if values.size > NUMBERS:
            total = np.nansum(values * [_sign(k) for k in range(values.size)])
            found[f"all of {name}"] = ["number", [float(total)], scale * values.size**0.5]
    return found


def of_json(path: Path) -> dict[str, list[float]]:
    """Numbers by their keys, those of a list together; a name stands before the brace of a model state."""
    found: dict[str, list[float]] = {}

    def look(value: Any, where: str) -> None:
        if isinstance(value, dict | list):
            named = isinstance(value, dict)
            for key, one in value.items() if named else enumerate(value):
                look(one, f"{where}/{key}" if named else where)
        elif isinstance(value, int | float):
            found.setdefault(where, []).append(float(value))

    text = path.read_text(encoding="utf-8")
    look(json.loads(text[text.index("{") :]), path.name)
    return found


def of_lines(path: Path) -> dict[str, list[float]]:
    """Numbers of PVL by their keywords, of a table by their columns, rows sorted by their text."""
    text, found = path.read_text(encoding="utf-8"), dict[str, list[float]]()
    if path.suffix == ".pvl":
        lines = [(key, re.split("[\\s,()]+", value)) for key, value in re.findall(r"(\w+) += (\([^)]*\)|.*)", text)]
    else:
        lines = [("", re.split(r"\s*,\s*|\s+", line)) for line in sorted(text.splitlines()) if not line.startswith("#")]
    for key, words in lines:
        for k, word in enumerate(words):
            if re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?|nan", word):
                found.setdefault(f"{path.name}/{key or k}", []).append(float(word))
    return found


def of_kernels(folder: Path) -> dict[str, list[float]]:
    """Positions, velocities (km) and matrices at five lines of each image, as CSPICE finds them."""
    import spiceypy

    found: dict[str, list[float]] = {}
    with chdir(folder):
        spiceypy.furnsh("adjusted.tm")
        try:
            for number in spiceypy.gipool("MGSGRAPH_INSTRUMENTS", 0, 1000).tolist():
                texts = (f"INS{number}_{one}" for one in ("IMAGE", "FRAME", "BODY_FRAME"))
                name, frame, body_frame = (spiceypy.gcpool(one, 0, 1)[0] for one in texts)
                numbers = (f"INS{number}_{one}" for one in ("SPACECRAFT", "BODY", "IMAGE_LINES"))
                craft, body, lines = (int(spiceypy.gdpool(one, 0, 1)[0]) for one in numbers)
                _, start, period = spiceypy.gdpool(f"INS{number}_LINE_TIMES", 0, 3)
                for time in start + period * lines * np.linspace(0.0, 1.0, 5):
                    state = spiceypy.spkezr(str(craft), time, body_frame, "NONE", str(body))[0]
                    # the other way CSPICE asks for the body's rotation, which the kernels don't need
                    turn = spiceypy.pxform(frame, body_frame, time)
                    for what, values in (("position", state[:3]), ("velocity", state[3:]), ("rotation", turn)):
                        found.setdefault(f"{name} {what}", []).extend(_long(values))
        finally:
            spiceypy.unload("adjusted.tm")
    return found


def prefixed(prefix: str, result: Result) -> Result:
    """Each quantity with what it is of."""
    return {f"{prefix}: {name}": quantity for name, quantity in result.items()}


def command(*arguments: object) -> None:
    """A command that must end well."""
    done = run(*arguments)
    assert done.returncode == 0, done.stderr


_simulated = dict[str, TemporaryDirectory[str]]()
"""Folders of what was simulated, of each once."""


def case_file(case: str) -> Path:
    """One in scripts/cases, or that of what `simulate` is told."""
    if case.endswith(".toml"):
        return ROOT / "scripts" / "cases" / case
    if case not in _simulated:
        _simulated[case] = TemporaryDirectory()
        command("simulate", *case.split(), "--out", Path(_simulated[case].name, "site"))
    return Path(_simulated[case].name, "site", "case.toml")


def adjusted(case: str, _: Path) -> Result:
    """The solution of a case."""
    return of_solution(mgsgraph.adjust(mgsgraph.read_case(case_file(case))))


def files(case: str, targets: Iterable[str], folder: Path) -> Result:
    """The numbers of `analyze`, and those in files for other programs."""
    path, result = case_file(case), folder / "result"
    command("adjust", path, "--out", result, "--no-figures")
    command("analyze", result, "--out", folder / "analyze", "--no-figures")
    columns = of_json(folder / "analyze" / "analysis.json")
    # of two measures that check one another alone it names one: w may have either sign
    columns = {name: np.abs(column).tolist() if "suspects/w" in name else column for name, column in columns.items()}
    found = prefixed("analyze", of_columns(columns))
    for target in targets:
        more = ["--case", path] if target in ("csm", "asp") else []
        command("export", result, "--to", target, "--out", folder / target, *more)
        if target == "spice":
            found |= prefixed(target, of_columns(of_kernels(folder / target), POSE))
        for file in sorted((folder / target).iterdir()):
            if file.suffix in (".csv", ".pvl", ".gcp"):
                scale = (1.0, DIGIT) if file.suffix == ".csv" else (POSE, 0.0)
                found |= prefixed(target, of_columns(of_lines(file), *scale))
            elif file.suffix == ".json" and target in ("csm", "isis") and file.name != "export.json":
                found |= prefixed(target, of_columns(of_json(file), POSE))
    return found


def grown(folder: Path) -> Result:
    """A project of five images that come one by one; `solve` after the third, so that iSAM2 adds the others."""
    site, project, found = case_file("strip --images 5 --ties 80 --steps").parent, folder / "project", Result()
    sigmas = folder / "settings.toml"
    sigmas.write_text("format = 1\n[orientation]\nposition_sigma_m = 100.0\nangle_sigma_mrad = 0.29\n", "utf-8")
    command("project", "init", project, "--name", "grown", "--settings", sigmas)
    for k, image in enumerate(sorted(site.glob("image_*.isd"))):
        step, impact = site / f"step_{k:03d}", folder / f"impact_{k}.csv"
        brought = ["--shots", step / "lidar.json", "--impact", impact, *(["--ties", step / "ties.pvl"] if k else [])]
        command("project", "add", project, f"STRIP/{image.stem.removeprefix('image_')}={image}", *brought)
        found |= of_columns(of_lines(impact))
        if k in (2, 4):
            command("project", "solve", project, "--no-figures")
            solution = mgsgraph.read_solution(max((project / "solutions").iterdir()))
            found |= prefixed(f"{k + 1} images", of_solution(solution))
    return found


def incremental(_: Path) -> Result:
    """A strip without an image that iSAM2 has taken out."""
    solution = mgsgraph.adjust(mgsgraph.read_case(case_file("strip --images 6 --ties 80")))
    adjustment, found = mgsgraph.IncrementalAdjustment.of(solution), Result()
    adjustment.remove("STRIP/002N")
    for name in adjustment.images:
        covariance, value = adjustment.covariance(name), adjustment.correction(name).coefficients
        found[name] = ["estimate", _long(value), _short(np.sqrt(np.diagonal(covariance)))]
        found[f"covariance of {name}"] = _covariance(covariance)
    return found | _of_points(*adjustment.points())


GOLDEN = {
    "gusev": Golden(partial(adjusted, "gusev --no-pictures")),
    "isidis": Golden(partial(adjusted, "isidis --no-pictures")),
    "lro_nac_lola": Golden(partial(adjusted, "lro_nac_lola.toml"), ("lro_nac_lola",)),
    "moc_wa_three": Golden(partial(adjusted, "moc_wa_three.toml"), ("mgs_moc_wa_three",)),
    "moc_wa_three_mola": Golden(partial(adjusted, "moc_wa_three_mola.toml"), ("mgs_moc_wa_three", "mola_megdr")),
    "hadley_rig": Golden(partial(adjusted, "hadley_rig.toml"), ("lro_nac_hadley",)),
    "strip_12": Golden(partial(adjusted, "strip --images 12 --ties 150")),
    "block_100": Golden(partial(adjusted, "archive --kind block --images 100 --ties 10000")),
    "grown": Golden(grown),
    "incremental": Golden(incremental),
    "gusev_files": Golden(
        partial(files, "gusev --no-pictures", ("spice", "csm", "isis", "asp")), (),
        "linearity/(scatter|ratio_of_squares)|consistency/residuals/(mean|skewness|excess_kurtosis|p)$",
        "draws, and the independent residuals of few, take a basis that rounding decides: it differs by processor",
    ),
    "hadley_rig_files": Golden(
        partial(files, "hadley_rig.toml", ("spice", "isis")), ("lro_nac_hadley",), "weak/(sigma|parts)",
        "directions of which nothing was learned, all of one ratio: which is which of them, rounding decides",
    ),
}  # fmt: skip


def computed(name: str, folder: Path) -> Result:
    """The result of a case, in an empty folder."""
    case = GOLDEN[name]
    return {one: of for one, of in case.make(folder).items() if not (case.without and re.search(case.without, one))}


def stored(name: str) -> Result:
    """The golden one."""
    result: Result = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return result


def write(name: str, result: Result) -> None:
    """Keep it, one quantity a line, and the versions of the libraries."""
    RESULTS.mkdir(exist_ok=True)
    lines = ",\n".join(f"{json.dumps(one)}: {json.dumps(quantity)}" for one, quantity in result.items())
    (RESULTS / f"{name}.json").write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    (RESULTS / "versions.json").write_text(json.dumps(versions()) + "\n", encoding="utf-8")


def versions() -> dict[str, str]:
    """Of the libraries that compute."""
    return {name: version(name) for name in LIBRARIES}


def tolerances() -> dict[str, float]:
    """By kind; looser where the libraries are not those of the golden results."""
    same = versions() == json.loads((RESULTS / "versions.json").read_text(encoding="utf-8"))
    return {one: value * (1.0 if same or one == "count" else LOOSER) for one, value in TOLERANCES.items()}


def differences(golden: Result, found: Result, allowed: Mapping[str, float]) -> dict[str, float]:
    """Each quantity's largest difference in tolerances; infinite where one of the two hasn't got it."""
    worst = dict.fromkeys(golden | found, np.inf)
    for name in golden.keys() & found.keys():
        (value, scale), (other, _) = _scaled(*golden[name]), _scaled(*found[name])
        if golden[name][0] == found[name][0] and value.shape == other.shape:
            same = (value == other) | (np.isnan(value) & np.isnan(other))
            with np.errstate(divide="ignore", invalid="ignore"):
                off = np.where(same, 0.0, np.abs(value - other) / (scale * allowed[golden[name][0]]))
            worst[name] = float(np.where(np.isnan(off), np.inf, off).max(initial=0.0))
    return worst


def _scaled(kind: str, numbers: Any, scale: Any = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of a quantity, and the scale of each, in which its tolerance is."""
    values = np.atleast_1d(np.array(numbers, dtype=float))
    if kind == "estimate":
        return np.concatenate([values, scale]), np.tile(scale, 2)
    if kind == "covariance":
        row, column = np.tril_indices(round((8 * values.size + 1) ** 0.5 - 1) // 2)
        sigmas = np.sqrt(values[row == column])
        return values, sigmas[row] * sigmas[column]
    return values, np.abs(values) if kind == "cost" else np.broadcast_to(np.array(scale), values.shape)
