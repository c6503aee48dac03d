"""Exported SPICE kernels say the solution again, to SPICE alone, and a fault in any of them is seen."""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spiceypy
from outside import refuses
from pass_files import write_block
from spiceypy.utils.exceptions import SpiceyError

from mgsgraph.adjustment.solution import Solution, orientation_profiles
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import InputError
from mgsgraph.export import spice
from mgsgraph.export.spice import MissionClock, NaifIds, SpiceNaming, write_spice
from mgsgraph.export.spice_back import spice_differences
from mgsgraph.export.spice_nodes import TOLERANCE, AdjustedNodes, Reprojection, adjusted_nodes, reprojection
from mgsgraph.geometry import camera as optics
from mgsgraph.geometry.camera import Distortion, LrocNacDistortion, RadialDistortion
from mgsgraph.geometry.image import LineTiming, PushbroomImage, fit_polynomials
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.simulation.case_files import image_file
from mgsgraph.units import ARCSEC

LRO = Path(__file__).resolve().parents[2] / "scripts" / "cases" / "lro_nac_lola.toml"
AIM = 0.01
"""px, of the issue; ours stay below the interpolation's limit."""
CLOCK = """KPL/SCLK
\\begindata
SCLK_DATA_TYPE_94        = ( 1 )
SCLK01_TIME_SYSTEM_94    = ( 1 )
SCLK01_N_FIELDS_94       = ( 2 )
SCLK01_MODULI_94         = ( 4294967296 256 )
SCLK01_OFFSETS_94        = ( 0 0 )
SCLK01_OUTPUT_DELIM_94   = ( 2 )
SCLK_PARTITION_START_94  = ( 0.0 )
SCLK_PARTITION_END_94    = ( 1.0E12 )
SCLK01_COEFFICIENTS_94   = ( 0.0 -1.0E8 0.9999999 )
\\begintext
"""
WRONG_PCK = """KPL/PCK
\\begindata
BODY499_POLE_RA = ( 10 0 0 )
BODY499_POLE_DEC = ( 20 0 0 )
BODY499_PM = ( 30 100 0 )
\\begintext
"""


@pytest.fixture(scope="module")
def solution(pair_solution: Solution) -> Solution:
    return pair_solution


def with_images(solution: Solution, change: Callable[[PushbroomImage], PushbroomImage]) -> Solution:
    """The same corrections of other images."""
    images = tuple(change(image) for image in solution.network.images)
    return replace(solution, network=replace(solution.network, images=images))


def uncorrected(solution: Solution) -> Solution:
    return replace(solution, coefficients=tuple(np.zeros_like(one) for one in solution.coefficients))


def round_trip(solution: Solution, folder: Path, **naming: Any) -> float:
    write_spice(solution, folder, SpiceNaming(**naming))
    wanted = reprojection(solution)
    assert len(wanted.image) > 20
    return float(spice_differences(folder, wanted).max())


@contextmanager
def loaded(folder: Path, *more: Path) -> Iterator[None]:
    with chdir(folder), spiceypy.KernelPool([*map(str, more), "adjusted.tm"]):
        yield


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


# --- what comes back


def test_every_measure_comes_back(solution: Solution, tmp_path: Path) -> None:
    assert round_trip(solution, tmp_path) < TOLERANCE


def test_polynomials_come_back(solution: Solution, tmp_path: Path) -> None:
    assert round_trip(with_images(solution, lambda image: fit_polynomials(image)), tmp_path) < TOLERANCE


def test_the_real_pair_comes_back(shared_data: Path, tmp_path: Path) -> None:
    assert round_trip(adjust(read_case(LRO)), tmp_path) < TOLERANCE


BENT = [
    LrocNacDistortion(18.1), RadialDistortion(1e-3, -4.0, 200.0),
    optics.KaguyaDistortion((-9.6e-7, 9.8e-4, 8.6e-3, -3.7), (-1.4e-6, 1.4e-5, 2.7e-3, -6.2)),
    optics.KaguyaMiDistortion((-9.6e-7, 9.8e-4, 8.6e-3, -3.7), (-1.4e-6, 1.4e-5, 2.7e-3, 0.0)),
    optics.MocWideAngleDistortion((0.9993258, 0.4655529, -0.1548756, 1.827967, -3.057435, 2.226331), 1.0005, 0.2),
    optics.ThemisIrDistortion(1.001, 1e-3, 0.2),
]  # fmt: skip


@pytest.mark.parametrize("distortion", BENT, ids=lambda one: type(one).__name__)
def test_bent_optics_come_back(solution: Solution, tmp_path: Path, distortion: Distortion) -> None:
    bent = with_images(solution, lambda image: replace(image, interior=replace(image.interior, distortion=distortion)))
    assert np.abs(reprojection(bent).places - reprojection(solution).places).max() > 1e-3
    assert round_trip(bent, tmp_path) < TOLERANCE
    wanted = reprojection(bent)
    aside = wanted._replace(points=wanted.points[:, [1, 2, 0]])
    assert np.isinf(spice_differences(tmp_path, aside)).all()


def test_changing_line_periods_and_a_pause_come_back(solution: Solution, tmp_path: Path) -> None:
    def halting(image: PushbroomImage) -> PushbroomImage:
        first, (start, stop) = np.array([0.0, 0.3, 0.7]) * image.lines, image.trajectory.coverage
        step = 0.9 * (stop - start) / image.lines
        starts = start + step * first * [1.0, 1.0, 0.95]
        starts[2] += 2.5 * step
        return replace(image, timing=LineTiming(first, starts, step * np.array([0.999, 0.9, 1.01])))

    assert round_trip(with_images(solution, halting), tmp_path) < TOLERANCE


def test_the_missions_ids_and_clock_come_back(solution: Solution, tmp_path: Path) -> None:
    (tmp_path / "mission.tsc").write_text(CLOCK)
    (tmp_path / "out").mkdir()
    name = solution.network.images[0].name
    clock = MissionClock(-94, (tmp_path / "mission.tsc",))
    assert round_trip(solution, tmp_path / "out", images={name: NaifIds(-94, -94031)}, clock=clock) < TOLERANCE
    with loaded(tmp_path / "out"):
        time = reprojection(solution).times[0]
        matrix, _ = spiceypy.ckgp(-94031, spiceypy.sce2c(-94, time), 0, "MGSGRAPH_MARS_FIXED")
        assert np.array_equal(matrix, spiceypy.pxform("MGSGRAPH_MARS_FIXED", "MGSGRAPH_CAMERA_94031", time))
        assert spiceypy.gdpool("INS-94031_CK_TIME_BIAS", 0, 1)[0] == 0.0
    assert not (tmp_path / "out" / "adjusted.tsc").exists()


def test_strips_come_back(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert round_trip(adjust(read_case(write_block(tmp_path))), tmp_path / "out") < 1.5 * TOLERANCE
    for name in ("adjusted.tm", "adjusted.tf", "adjusted.ti", "adjusted.tsc"):
        assert max(map(len, (tmp_path / "out" / name).read_text().splitlines())) <= 132


def test_names_with_quotes_come_back(solution: Solution, tmp_path: Path) -> None:
    assert round_trip(with_images(solution, lambda image: replace(image, name=f"'{image.name}'")), tmp_path) < TOLERANCE


# --- against outside authorities, and against the solution line by line


def test_every_line_has_the_solutions_pose(solution: Solution, tmp_path: Path) -> None:
    write_spice(solution, tmp_path)
    (tmp_path / "wrong.tpc").write_text(WRONG_PCK)
    frame = "MGSGRAPH_MARS_FIXED"
    with loaded(tmp_path, tmp_path / "wrong.tpc"):
        for j in range(2):
            image = solution.image(j)
            lines = np.arange(0.0, image.lines, 7.0)
            pose, times = image.pose(lines, solution.correction(j)), image.timing.at(lines)[0] + image.trajectory.epoch
            states = np.array(spiceypy.spkezr(str(-900_001 - j), times, frame, "NONE", "MARS")[0])
            np.testing.assert_allclose(states[:, :3] * 1e3, pose.position, atol=1e-3)
            camera = f"MGSGRAPH_CAMERA_{900_001 + j}000"
            matrices = np.array([spiceypy.pxform(frame, camera, time) for time in times])
            np.testing.assert_allclose(matrices, pose.matrix, atol=1e-9)


def test_j2000_is_that_of_the_support_data(solution: Solution, pair_folder: Path, tmp_path: Path) -> None:
    write_spice(uncorrected(solution), tmp_path)
    for j, image in enumerate(solution.network.images):
        isd = json.loads((pair_folder / image_file(image)).read_text())
        start, stop = image.timing.at(np.array([0.0, float(image.lines)]))[0] + image.trajectory.epoch
        tables = isd["instrument_position"], isd["instrument_pointing"]
        with loaded(tmp_path):
            place, attitude = (
                [(t, v) for t, v in zip(table["ephemeris_times"], table[key], strict=True) if start <= t <= stop]
                for table, key in zip(tables, ("positions", "quaternions"), strict=True)
            )
            assert min(len(place), len(attitude)) > 3
            for time, position in place:
                got, _ = spiceypy.spkpos(str(-900_001 - j), time, "J2000", "NONE", "MARS")
                np.testing.assert_allclose(got, position, atol=1e-6)
            for time, quaternion in attitude:
                mount = np.reshape(tables[1].get("constant_rotation", np.eye(3)), (3, 3))
                got = spiceypy.pxform("J2000", f"MGSGRAPH_CAMERA_{900_001 + j}000", time)
                np.testing.assert_allclose(got, mount @ spiceypy.q2m(quaternion), atol=1e-8)


def test_rates_are_those_of_the_path(solution: Solution, tmp_path: Path) -> None:
    write_spice(solution, tmp_path)
    step = 0.02
    with loaded(tmp_path):
        for time in reprojection(solution).times[:20]:
            code = next(c for c in (-900_001, -900_002) if covers(c, time))
            state, _ = spiceypy.spkezr(str(code), time, "J2000", "NONE", "MARS")
            around = np.array([time - step, time + step])
            (before, after), _ = spiceypy.spkpos(str(code), around, "J2000", "NONE", "MARS")
            np.testing.assert_allclose(state[3:], (np.array(after) - before) / (2.0 * step), atol=1e-6)
            ticks = [spiceypy.sce2c(-900_000, time + shift) for shift in (-step, 0.0, step)]
            first, _, last = (spiceypy.ckgp(1000 * code, tick, 0, "J2000")[0] for tick in ticks)
            _, angular_rate, _ = spiceypy.ckgpav(1000 * code, ticks[1], 0, "J2000")
            axis, angle = spiceypy.raxisa(first.T @ last)  # frames turn back what components turn
            np.testing.assert_allclose(angular_rate, -first.T @ (first @ axis) * angle / (2.0 * step), atol=1e-7)


def covers(code: int, time: float) -> bool:
    window = spiceypy.spkcov("adjusted.bsp", code)
    return bool(spiceypy.wnincd(time - 0.1, time + 0.1, window))


def test_polynomials_need_a_pck_for_j2000_alone(solution: Solution, tmp_path: Path) -> None:
    write_spice(with_images(solution, lambda image: fit_polynomials(image)), tmp_path)
    assert not (tmp_path / "body.bc").exists()
    time = reprojection(solution).times[0]
    (tmp_path / "some.tpc").write_text(WRONG_PCK)
    with loaded(tmp_path):
        code = str(next(c for c in (-900_001, -900_002) if covers(c, time)))
        fixed, _ = spiceypy.spkpos(code, time, "MGSGRAPH_MARS_FIXED", "NONE", "MARS")
        with pytest.raises(SpiceyError):
            spiceypy.spkpos(code, time, "J2000", "NONE", "MARS")
        spiceypy.furnsh("some.tpc")
        np.testing.assert_array_equal(spiceypy.spkpos(code, time, "IAU_MARS", "NONE", "MARS")[0], fixed)


def test_spice_knows_the_field_of_view(solution: Solution, tmp_path: Path) -> None:
    """The ends of the first line see the ground where the image's own first and last sample do."""
    write_spice(solution, tmp_path)
    with loaded(tmp_path):
        for number, j in zip(spiceypy.gdpool("MGSGRAPH_INSTRUMENTS", 0, 9).astype(int).tolist(), range(2), strict=True):
            shape, frame, boresight, count, corners = spiceypy.getfov(number, 9)
            assert (shape, count) == ("POLYGON", 4)
            assert frame == f"MGSGRAPH_CAMERA_{-number}"
            image, lines = solution.image(j), np.zeros(3)
            _, true = image.sightlines(lines, np.array([0.0, 0.5, 1.0]) * image.samples, solution.correction(j))
            turn = image.pose(lines[:1], solution.correction(j)).matrix[0]
            seen = np.array([corners[0] + corners[1], 2.0 * boresight, corners[2] + corners[3]]) @ turn
            for mine, theirs in zip(seen, true, strict=True):
                assert spiceypy.vsep(mine, theirs) < 1e-3 * image.pixel_angle
            assert spiceypy.vsep(corners[0], corners[1]) == pytest.approx(
                image.pixel_angle / image.interior.sample_summing, rel=0.01
            )


def test_binary_kernels_say_what_they_are(solution: Solution, tmp_path: Path) -> None:
    """Comments: who made them of what, and how well; coverage, ids and frame, as spiceypy reads them."""
    resected = {"SIM/A": ("resected: by ties",)}
    moc = with_images(solution, lambda one: replace(one, mission="MGS", remarks=resected.get(one.name, ())))
    write_spice(moc, tmp_path, origin="Made by me.")
    words, profile = list[str](), orientation_profiles(solution)
    for name in ("adjusted.bsp", "adjusted.bc", "body.bc"):
        handle = spiceypy.dafopr(str(tmp_path / name))
        words.append("\n".join(spiceypy.dafec(handle, 1000, 200)[1]))
        spiceypy.dafcls(handle)
    assert (len(set(words)), "\nMade by me.\n" in words[0], words[0].count("-1.15")) == (1, True, 1)
    found = re.findall(r"Sigmas of position (.*) m, of pointing (.*) arcsec", words[0])
    stated = np.array([[part.replace(",", "").split() for part in row] for row in found], dtype=float)
    for j, sigmas in enumerate((profile.position_sigma, profile.rotation_sigma / ARCSEC)):
        np.testing.assert_allclose(stated[:, j], sigmas.reshape(2, -1, 3).mean(axis=1), rtol=0.06)
    with loaded(tmp_path):
        codes = list(spiceypy.spkobj("adjusted.bsp"))
        assert (codes, list(spiceypy.ckobj("adjusted.bc"))) == ([-900_002, -900_001], [-900_002_000, -900_001_000])
        for image, code in zip(moc.network.images, reversed(codes), strict=True):
            start, stop = image.timing.at(np.array([-10.0, image.lines + 10.0]))[0] + image.trajectory.epoch
            ck = spiceypy.ckcov("adjusted.bc", 1000 * code, True, "SEGMENT", 0.0, "TDB")
            for window in (spiceypy.spkcov("adjusted.bsp", code), ck):
                np.testing.assert_allclose(list(window), [start, stop], atol=0.03 * (stop - start))
            descriptor = spiceypy.spksfs(code, 0.5 * (start + stop), 40)[1]
            assert spiceypy.spkuds(descriptor)[:4] == (code, 499, spiceypy.namfrm("MGSGRAPH_MARS_FIXED"), 13)


# --- planted faults


def attitude_of_before(nodes: AdjustedNodes, image: PushbroomImage, correction: OrientationCorrection) -> AdjustedNodes:
    """The bias of MOC's attitude, once more."""
    return replace(nodes, matrices=image.pose(image.timing.lines(nodes.times - 1.15), correction).matrix)


FAULTS: dict[str, Callable[[AdjustedNodes, PushbroomImage, OrientationCorrection], AdjustedNodes]] = {
    "time bias twice": attitude_of_before,
    "quaternion convention": lambda nodes, *_: replace(nodes, matrices=nodes.matrices.mT),
    "velocities reversed": lambda nodes, *_: replace(nodes, velocities=-nodes.velocities),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_orientation_is_seen(
    solution: Solution, tmp_path: Path, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(image: PushbroomImage, correction: OrientationCorrection, covered: tuple[float, float]) -> AdjustedNodes:
        return FAULTS[fault](adjusted_nodes(image, correction, covered), image, correction)

    monkeypatch.setattr(spice, "adjusted_nodes", faulty)
    assert round_trip(solution, tmp_path) > AIM


def test_a_fault_of_the_clock_is_seen(solution: Solution, tmp_path: Path) -> None:
    assert round_trip(solution, tmp_path) < TOLERANCE
    text = (tmp_path / "adjusted.tsc").read_text()
    zero = text.split("COEFFICIENTS_900000  = ( 0.0 ")[1].split()[0]
    edit(tmp_path / "adjusted.tsc", f"( 0.0 {zero} 1.0 )", f"( 0.0 {float(zero) + 1.15!r} 1.0 )")
    assert spice_differences(tmp_path, reprojection(solution)).max() > AIM


@pytest.mark.parametrize(("key", "shift"), [("DETECTOR_FIRST", 0.5), ("FOCAL_LENGTH", 1.0),])
def test_a_fault_of_the_camera_is_seen(solution: Solution, tmp_path: Path, key: str, shift: float) -> None:
    assert round_trip(solution, tmp_path) < TOLERANCE
    start = f"INS-900001000_{key} = ( "
    old = start + (tmp_path / "adjusted.ti").read_text().split(start)[1].split()[0]
    edit(tmp_path / "adjusted.ti", old, start + repr(float(old.split()[-1]) + shift))
    assert spice_differences(tmp_path, reprojection(solution)).max() > AIM


def test_a_point_that_is_not_seen_is_infinitely_off(solution: Solution, tmp_path: Path) -> None:
    write_spice(solution, tmp_path)
    wanted = reprojection(solution)
    behind = Reprojection(wanted.image[:2], 1.5 * wanted.points[:2], wanted.places[:2], wanted.times[:2])
    assert np.isinf(spice_differences(tmp_path, behind)).all()


# --- the files


def test_files_depend_on_the_solution_alone(solution: Solution, tmp_path: Path) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
    one, two = (write_spice(solution, tmp_path / folder) for folder in ("one", "two"))
    assert [path.name for path in one] == [
        "adjusted.tm", "adjusted.tsc", "adjusted.tf", "adjusted.ti", "adjusted.tpc", "body.bc", "adjusted.bsp",
        "adjusted.bc",
    ]  # fmt: skip
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == sorted(path.name for path in one)
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(one, two, strict=True))


def test_a_pool_of_ones_own_survives(solution: Solution, tmp_path: Path) -> None:
    (tmp_path / "mine.tpc").write_text(WRONG_PCK)
    (tmp_path / "out").mkdir()
    with spiceypy.KernelPool([str(tmp_path / "mine.tpc")]):
        mine = list(spiceypy.gdpool("BODY499_PM", 0, 9))
        assert round_trip(solution, tmp_path / "out") < TOLERANCE
        assert spiceypy.ktotal("ALL") == 1
        assert list(spiceypy.gdpool("BODY499_PM", 0, 9)) == mine
        assert not spiceypy.expool("MGSGRAPH_INSTRUMENTS")
        spiceypy.kclear()


# --- what can't be held


class Odd:
    """Optics that no kernel knows."""

    def undistort(self, place: Any) -> Any:
        return place, np.broadcast_to(np.eye(2), (place.shape[0], 2, 2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda image: replace(image, name=f"Größe {image.name}"), "name: a name with letters beyond ASCII"),
        (lambda image: replace(image, interior=replace(image.interior, distortion=Odd())), "distortion: the model Odd"),
    ],
)
def test_what_kernels_cannot_hold_is_named(
    solution: Solution, tmp_path: Path, change: Callable[[PushbroomImage], PushbroomImage], message: str
) -> None:
    refuses(message, write_spice, with_images(solution, change), tmp_path)


def test_ids_must_be_apart_and_known(solution: Solution, tmp_path: Path) -> None:
    first, second = solution.network.images
    same_time = replace(solution, network=replace(solution.network, images=(first, replace(first, name=second.name))))
    ids = {image.name: NaifIds(-94, -94031) for image in (first, second)}
    refuses(r"NAIF id .*at the same time", write_spice, same_time, tmp_path, SpiceNaming(images=ids))
    refuses("nobody: no image", write_spice, solution, tmp_path, SpiceNaming(images={"nobody": NaifIds(-94, -94031)}))
    (tmp_path / "other.tsc").write_text(CLOCK)
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="clock -95: SPICE says"):
        write_spice(solution, tmp_path / "out", SpiceNaming(clock=MissionClock(-95, (tmp_path / "other.tsc",))))
    refuses(r"adjusted\.tm: no such file", spice_differences, tmp_path / "nothing", reprojection(solution))


def test_what_spice_cannot_write_is_one_line(
    solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise SpiceyError("An attempt to write to a file failed")

    with monkeypatch.context() as patch:
        patch.setattr(spiceypy, "spkw13", full)
        refuses(r"adjusted.bsp: SPICE says: .*failed.*; free some space", write_spice, solution, tmp_path)
    assert round_trip(solution, tmp_path) < TOLERANCE
