"""Trajectories out of kernels and aberration undone are SPICE's own; the pool stays as it was; faults are said."""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from hypothesis import given
from hypothesis import strategies as st
from mgs import START, STOP, kernels
from outside import refuses
from strategies import directions, turned

from mgsgraph.errors import InputError
from mgsgraph.files.labels.aberration import Aberration, aberrated, geometric, without_aberration
from mgsgraph.files.labels.kernels import (
    clock_time,
    ellipsoid,
    fixed_rotation,
    loaded,
    members,
    pool_numbers,
    require_whole,
    sample_trajectory,
)
from mgsgraph.geometry import rotation
from mgsgraph.geometry.trajectory import PositionTable, Trajectory
from mgsgraph.units import KM, MM, SPEED_OF_LIGHT

ARCSEC = np.pi / 180.0 / 3600.0
MGS, STRUCTURE, NARROW = -94, -94000, -94031


@pytest.fixture(autouse=True)
def _empty_pool() -> Iterator[None]:
    spiceypy.kclear()
    yield
    spiceypy.kclear()


@pytest.fixture
def mgs_kernels(shared_data: Path) -> list[Path]:
    return kernels(shared_data)


def sampled(interval: float = 0.5, bias: float = -1.15, **settings: object) -> Trajectory:
    return sample_trajectory(
        MGS, "MARS", STRUCTURE, np.eye(3), START, STOP, interval, attitude_bias=bias, **settings  # type: ignore[arg-type]
    )


def pointing(times: np.ndarray, bias: float) -> np.ndarray:
    """CK(t + bias), by ckgp alone."""
    return np.stack([spiceypy.ckgp(STRUCTURE, spiceypy.sce2c(MGS, time + bias), 0.0, "J2000")[0] for time in times])


def places(times: np.ndarray, correction: str = "NONE") -> np.ndarray:
    return np.array(spiceypy.spkezr("-94", times, "J2000", correction, "499")[0])[:, :3] * 1e3


# --- parity with SPICE


def test_start_middle_and_end_are_those_of_spice(mgs_kernels: list[Path]) -> None:
    with loaded(mgs_kernels):
        got = sampled()
        times = np.array([START, got.epoch, STOP])
        since = times - got.epoch
        assert got.epoch == pytest.approx(0.5 * (START + STOP), abs=1e-8)
        assert all(np.isin(since, table.times).all() for table in (got.position, got.camera, got.body))
        np.testing.assert_allclose(got.position.at(since)[0], places(times), rtol=0, atol=1e-6)
        assert turned(got.camera.at(since)[0], pointing(times, -1.15)) < 1e-9
        fixed = np.stack([spiceypy.pxform("J2000", "IAU_MARS", time) for time in times])
        assert turned(got.body.at(since)[0], fixed) < 1e-12


@pytest.mark.parametrize(("interval", "bias"), [(0.1, -1.15), (2.0, 1.14)])
def test_anywhere_in_between_it_stays_with_spice(mgs_kernels: list[Path], interval: float, bias: float) -> None:
    """Within 1 mm and 0.01 arcsec, the margins before the first and after the last line included."""
    with loaded(mgs_kernels):
        got = sampled(interval, bias)
        assert got.coverage == pytest.approx((START - got.epoch - 2.0, STOP - got.epoch + 2.0), abs=1e-6)
        times = got.epoch + np.random.default_rng(1).uniform(*got.coverage, 300)
        since = times - got.epoch
        assert np.abs(got.position.at(since)[0] - places(times)).max() < 1e-3
        assert turned(got.camera.at(since)[0], pointing(times, bias)) < 0.01 * ARCSEC
        fixed = np.stack([spiceypy.tipbod("J2000", 499, time) for time in times])
        assert turned(got.body.at(since)[0], fixed) < 0.01 * ARCSEC
        after, before = got.camera.quaternions[1:], got.camera.quaternions[:-1]
        np.testing.assert_array_less(0.0, np.einsum("ni,ni->n", after, before))


def test_position_bias_moves_positions_only(mgs_kernels: list[Path]) -> None:
    with loaded(mgs_kernels):
        plain, moved = sampled(), sampled(position_bias=0.3)
        times = np.array([START, STOP])
        np.testing.assert_allclose(moved.position.at(times - moved.epoch)[0], places(times + 0.3), rtol=0, atol=1e-4)
    np.testing.assert_array_equal(plain.camera.quaternions, moved.camera.quaternions)


def test_aberration_gives_the_positions_of_isis_tables(mgs_kernels: list[Path]) -> None:
    """Start position of M04/02852 in ALE's published support data, which are LT+S seen from the body."""
    with loaded(mgs_kernels):
        got = sampled(aberration="LT+S").position.at(np.array([START - 0.5 * (START + STOP)]))[0]
        geometric = places(np.array([START]))
    want = 1e3 * np.array([[-1745.7033016421271, 1342.9623258406766, -3030.553596888067]])
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-3)
    assert np.linalg.norm(got - geometric) == pytest.approx(145.0, abs=1.0)


def test_dense_noisy_records_of_a_ck_are_kept(mgs_kernels: list[Path], tmp_path: Path) -> None:
    """Records every 0.13 s with 5 arcsec of noise: a regular grid would miss what SPICE says between them."""
    path, rng = tmp_path / "noisy.bc", np.random.default_rng(7)
    with loaded(mgs_kernels):
        times = np.arange(START - 20.0, STOP + 20.0, 0.13)
        matrices = rotation.exponential(rng.normal(0.0, 5.0 * ARCSEC, (times.size, 3))) @ pointing(times, 0.0)
        ticks = np.array([spiceypy.sce2c(MGS, time) for time in times])
        handle = spiceypy.ckopn(str(path), "noisy", 0)
        quaternions = rotation.from_matrix(matrices)
        spiceypy.ckw03(
            handle, ticks[0], ticks[-1], STRUCTURE, "J2000", False, "noisy", ticks.size, ticks, quaternions,
            np.zeros((ticks.size, 3)), 1, ticks[:1],
        )  # fmt: skip
        spiceypy.ckcls(handle)
    with loaded([*mgs_kernels, path]):
        got = sampled()
        asked = got.epoch + rng.uniform(*got.coverage, 300)
        assert turned(got.camera.at(asked - got.epoch)[0], pointing(asked, -1.15)) < 0.01 * ARCSEC


def test_the_camera_frame_is_the_one_of_the_last_instrument_kernel(shared_data: Path) -> None:
    for order in (("moc20.ti", "mocAddendum004.ti"), ("mocAddendum004.ti", "moc20.ti")):
        with loaded(kernels(shared_data, order)):
            got = fixed_rotation(STRUCTURE, NARROW)
            angles = pool_numbers("TKFRAME_-94031_ANGLES", 3)
        # R1 R2 R3 of a TK frame lead from the camera to the structure (NAIF frames required reading)
        product = np.eye(3)
        for axis, angle in zip((1, 2, 3), angles, strict=True):
            product = product @ spiceypy.rotate(angle, axis)
        np.testing.assert_allclose(got, product.T, rtol=0, atol=1e-15)


def test_the_body_is_that_of_the_constants(mgs_kernels: list[Path]) -> None:
    with loaded(mgs_kernels):
        mars = ellipsoid("Mars")
        assert (mars.equatorial, mars.polar) == (3_396_190.0, 3_376_200.0)
        refuses("body of revolution", ellipsoid, "PHOBOS")
        refuses("'Krypton'; expected a name", ellipsoid, "Krypton")


# --- the pool


def contents() -> tuple[object, ...]:
    files = [spiceypy.kdata(k, "ALL")[:3] for k in range(spiceypy.ktotal("ALL"))]
    names = sorted(spiceypy.gnpool("*", 0, 100_000)) if files else []
    kinds = {name: spiceypy.dtpool(name) for name in names}
    values = {
        name: list(spiceypy.gcpool(name, 0, n, 200)) if kind == "C" else spiceypy.gdpool(name, 0, n).tolist()
        for name, (n, kind) in kinds.items()
    }
    return files, values


@pytest.mark.parametrize("fails", [False, True])
def test_the_callers_files_are_loaded_again(mgs_kernels: list[Path], tmp_path: Path, fails: bool) -> None:
    listed = ",\n".join(f"'{path}'" for path in mgs_kernels[:3])
    meta = tmp_path / "mine.tm"
    meta.write_text(f"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( {listed} )\nOWN = 'kept'\n\\begintext\n")
    spiceypy.furnsh(str(meta))
    spiceypy.furnsh(str(mgs_kernels[-1]))
    before = contents()

    try:
        with loaded(mgs_kernels[:4]):
            assert spiceypy.ktotal("ALL") == 4
            assert spiceypy.gdpool("BODY499_RADII", 0, 3)[0] == 3396.19
            spiceypy.pdpool("LITTER", [1.0])
            if fails:
                raise ZeroDivisionError
    except ZeroDivisionError:
        assert fails

    assert contents() == before


def test_meta_kernels_find_files_by_symbol_and_beside_them(
    mgs_kernels: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "beside.tls").write_bytes(mgs_kernels[0].read_bytes())
    (tmp_path / "here.tpc").write_bytes(mgs_kernels[1].read_bytes())
    monkeypatch.chdir(tmp_path)
    folder = mgs_kernels[2].parent
    meta = Path("site") / "all.tm"
    meta.write_text(
        f"KPL/MK\n\\begindata\nPATH_VALUES = ( '{folder}' )\nPATH_SYMBOLS = ( 'MGS' )\n"
        "KERNELS_TO_LOAD = ( 'beside.tls', 'here.tpc'\n '$MGS/MGS_SCLKSCET+'\n '.00061.tsc' )\n\\begintext\n"
    )
    with loaded([meta]):
        assert clock_time(MGS, "619971158:28") == pytest.approx(START, abs=1e-7)
        assert ellipsoid(499).polar == 3_376_200.0


# --- what is missing or wrong


CUT = {
    "PATH_VALUES = ( '{text:81}' )": "line 3, PATH_VALUES: a text of 81 characters; .* 80 characters; continue with",
    "KERNELS_TO_LOAD = ( 'a.tls',\n '{text:140}' )": "line 4, KERNELS_TO_LOAD: a text of 140 characters",
    "KERNELS_TO_LOAD += ( '{text:70}', '{text:70}' )": "line 3, KERNELS_TO_LOAD: a line of 169 characters",
}


@pytest.mark.parametrize("data", CUT)
def test_what_spice_would_cut_off_is_named(tmp_path: Path, data: str) -> None:
    meta = tmp_path / "a.tm"
    meta.write_text(f"KPL/MK\n\\begindata\n{data.replace(':', ':x<').format(text='')}\nKERNELS_TO_LOAD = 'a'\n")
    refuses(CUT[data], members, meta)


def test_texts_of_80_characters_and_long_comments_are_read(tmp_path: Path) -> None:
    meta, text = tmp_path / "a.tm", "x" * 79
    (tmp_path / f"{text}y").write_text("KPL/FK\n\\begindata\nA = 1\n")
    (tmp_path / "it's").write_text(f"KPL/FK\n\\begindata\nA = '{'z' * 100}'\n")
    meta.write_text(
        f"KPL/MK\n'{'c' * 200}'\n\\begindata\nKERNELS_TO_LOAD = ( '{text}y',\n '{text}+'\n 'y', 'it''s' )\n"
        f"\\begintext\n'{'c' * 200}'\n"
    )
    assert [path.name for path in members(meta)] == [f"{text}y", "it's"]  # one that is named twice is loaded once


def test_a_kernel_named_thousands_of_times_is_read_once_at_its_last_place(tmp_path: Path) -> None:
    for name in ("a.tf", "b.tf"):
        (tmp_path / name).write_text("KPL/FK\n\\begindata\nA = 1\n")
    names = "\n".join(f"'{name}'" for name in ["a.tf", "b.tf", *["a.tf"] * 6000])
    (tmp_path / "a.tm").write_text(f"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = (\n{names}\n)\n")
    assert [path.name for path in members(tmp_path / "a.tm")] == ["b.tf", "a.tf"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("notes.txt", b"nothing of SPICE", "notes.txt: no SPICE kernel"),
        ("cut.bsp", b"DAF/SPK " + bytes(200), "cut.bsp: 208 bytes; expected 1024"),
        ("broken.tpc", b"KPL/PCK\n\\begindata\nA = ( 1, 'x' )\n", "broken.tpc: SPICE says: "),
        ("meta.tm", b"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( 'lost.bc' )\n", "meta.tm: the kernel 'lost.bc' that it"),
    ],
)
def test_a_kernel_that_is_none(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught, loaded([tmp_path / name]):
        pass
    assert said in str(caught.value)
    assert contents()[0] == []


@pytest.mark.parametrize("suffix", [".bsp", ".bc"])
def test_a_kernel_cut_short_is_said_with_both_sizes(mgs_kernels: list[Path], tmp_path: Path, suffix: str) -> None:
    whole = next(path for path in mgs_kernels if path.suffix == suffix).read_bytes()
    cut = tmp_path / f"cut{suffix}"
    for size in (90, 1000, 1024, 3000, len(whole) // 2):
        cut.write_bytes(whole[:size])
        with pytest.raises(InputError, match=rf"cut{suffix}: {size} bytes; expected "), loaded([cut]):
            pass


def test_gaps_are_refused_with_what_is_covered(mgs_kernels: list[Path]) -> None:
    said = r"positions of -94.*1999-08-24T13:58:15.744.*1999-08-24T14:10:13.635 \.\. 1999-08-24T14:14:19.559 UTC"
    with loaded(mgs_kernels), pytest.raises(InputError, match=said):
        sample_trajectory(MGS, "MARS", STRUCTURE, np.eye(3), START - 400.0, STOP, attitude_bias=-1.15)


def test_the_margin_ends_with_the_kernels(mgs_kernels: list[Path]) -> None:
    with loaded(mgs_kernels):
        got = sample_trajectory(
            MGS, "MARS", STRUCTURE, np.eye(3), -11224122.0, STOP, attitude_bias=1.15, margin=5.0, interval=2.0
        )
        start = got.epoch + got.coverage[0]
        assert start == pytest.approx(-11224122.182, abs=1e-3)
        assert np.abs(got.position.positions[:1] - places(np.array([start]))).max() < 1e-3


@pytest.mark.parametrize(
    ("left_out", "said"),
    [(".bsp", "at least one SPK"), (".bc", "at least one CK"), (".tsc", "load the SCLK"), ("tpc", "load the PCK")],
)
def test_each_kind_of_kernel_is_missed(mgs_kernels: list[Path], left_out: str, said: str) -> None:
    fewer = [path for path in mgs_kernels if not path.name.endswith(left_out)]
    with loaded(fewer), pytest.raises(InputError, match=said):
        sampled()


def test_constants_that_are_missing_or_of_another_kind(mgs_kernels: list[Path]) -> None:
    with loaded(mgs_kernels[:1]):
        refuses("no INS-94031_PIXEL_PITCH", pool_numbers, "INS-94031_PIXEL_PITCH", 1)
        spiceypy.pdpool("PAIR", [1.0, 2.0])
        refuses(r"PAIR: 2 numbers; expected 3 number\(s\)", pool_numbers, "PAIR", 3)


# --- binary kernels that are damaged


def test_true_kernels_are_sound(shared_data: Path) -> None:
    """All there are, in SPK, CK and binary PCK; and text passes by."""
    found = [path for path in sorted(shared_data.rglob("*")) if path.suffix.lower() in (".bsp", ".bc", ".bpc", ".tls")]
    assert {path.suffix for path in found} == {".bsp", ".bc", ".bpc", ".tls"}
    for path in found:
        require_whole(path)


@pytest.mark.parametrize("kernel", ["m0402852.ale_1.bsp", "mgs_sc_map2_0_sliced_-94000.bc"])
def test_binary_ones_that_count_more_words_are_refused(shared_data: Path, tmp_path: Path, kernel: str) -> None:
    content = bytearray(next(path for path in kernels(shared_data) if path.name == kernel).read_bytes())
    assert struct.unpack_from("<3i", content, 76)[:2] == (3, 3)
    struct.pack_into("<i", content, 84, 2**31 - 1)  # its free word
    path = tmp_path / kernel
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        require_whole(path)
    assert kernel in caught.value.where


# --- light time and stellar aberration undone, against SPICE (data/README.md, trap 1)


_KERNELS = ("naif0012.tls", "pck00009.tpc", "m0402852.ale_1.bsp")
TIMES = {
    "3 nodes, as in ISIS cubes": np.array([-0.4, 0.0, 0.4]),
    "1 s": np.arange(-5.0, 5.5),
    "10 s": np.arange(-30.0, 31.0, 10.0),
}


@pytest.fixture
def et(shared_data: Path) -> Iterator[float]:
    """Middle of image M04/02852 with the MGS and planet ephemerides loaded, which hold Mars, the Sun and the SSB."""
    with spiceypy.KernelPool([str(shared_data / "mgs_moc_m0402852" / name) for name in _KERNELS]):
        yield spiceypy.utc2et("1999-08-24T14:12:13.6")


def states(target: str, times: np.ndarray, correction: str, observer: str) -> np.ndarray:
    """(n, 6) m and m/s, J2000."""
    return KM * np.array([spiceypy.spkezr(target, t, "J2000", correction, observer)[0] for t in times])


def apparent(et: float, times: np.ndarray, body_observes: bool) -> PositionTable:
    table = states("MGS", et + times, "LT+S", "MARS") if body_observes else -states("MARS", et + times, "LT+S", "MGS")
    return PositionTable(times, table[:, :3], table[:, 3:])


def lt_s(body_observes: bool, to_surface: bool = False) -> Aberration:
    return Aberration("LT+S", "body" if body_observes else "spacecraft", to_surface)


@pytest.mark.parametrize("body_observes", [True, False], ids=["body observes", "spacecraft observes"])
def test_light_time_to_the_surface_is_undone(et: float, body_observes: bool) -> None:
    """Tables as ISIS and ALE make them: both about the barycentre, the target's so long before as light takes."""
    craft, mars = ("MGS", "MARS") if body_observes else ("MARS", "MGS")
    radius, times = 3386195.0, TIMES["1 s"]
    light = [spiceypy.spkezr(craft, et + t, "J2000", "LT+S", mars)[1] - radius / SPEED_OF_LIGHT for t in times]
    seen = states(craft, et + times - light, "NONE", "SSB") - states(mars, et + times, "NONE", "SSB")
    table = seen if body_observes else -seen
    velocity = states("MARS", np.array([et]), "NONE", "SUN")[0, 3:]
    found = geometric(PositionTable(times, table[:, :3], table[:, 3:]), velocity, lt_s(body_observes, True), radius)

    true = states("MGS", et + times, "NONE", "MARS")[:, :3]
    assert np.linalg.norm(table[:, :3] - true, axis=1).min() > 20.0
    assert np.linalg.norm(found.positions - true, axis=1).max() < 0.1


@pytest.mark.parametrize("spacing", TIMES)
@pytest.mark.parametrize("body_observes", [True, False], ids=["body observes", "spacecraft observes"])
def test_apparents_of_mgs_become_geometric(et: float, spacing: str, body_observes: bool) -> None:
    """145 m of apparent displacement fall to 0.3 m with the heliocentric velocity, to 2 mm with that about the SSB."""
    times = TIMES[spacing]
    table, true = apparent(et, times, body_observes), states("MGS", et + times, "NONE", "MARS")
    before = np.linalg.norm(table.positions - true[:, :3], axis=1)
    assert np.all((before > 140.0) & (before < 150.0))

    for origin, limit, rate_limit in (("SUN", 0.3, MM), ("SSB", 2 * MM, 0.1 * MM)):
        velocity = states("MARS", np.array([et]), "NONE", origin)[0, 3:]
        found = geometric(table, velocity, lt_s(body_observes))
        assert np.linalg.norm(found.positions - true[:, :3], axis=1).max() < limit
        assert np.linalg.norm(found.velocities - true[:, 3:], axis=1).max() < rate_limit
        np.testing.assert_array_equal(found.times, times)


speeds = st.builds(lambda axis, speed: axis * speed, directions, st.floats(0.0, 30e3))


@given(directions, speeds)
def test_aberration_is_that_of_spice(direction: np.ndarray, velocity: np.ndarray) -> None:
    """NAIF stelab, at speeds up to 30 km/s; to see a tenth of a millimetre at 4000 km."""
    found = aberrated(direction[None], velocity[None] / SPEED_OF_LIGHT)

    np.testing.assert_allclose(found[0], spiceypy.stelab(direction, velocity / KM), atol=1e-15)


@given(directions, speeds)
def test_aberration_is_undone(direction: np.ndarray, velocity: np.ndarray) -> None:
    seen = 4e6 * aberrated(direction[None], velocity[None] / SPEED_OF_LIGHT)

    np.testing.assert_allclose(without_aberration(seen, velocity)[0], 4e6 * direction, atol=1e-8)


@pytest.mark.parametrize("body_observes", [True, False])
def test_a_body_at_rest_still_has_a_light_time(body_observes: bool) -> None:
    """Seen from the body, the craft is 12.7 ms late along its path; the craft sees the body turned by its own motion.
    At rest both are the same 43 m.
    """
    times = np.linspace(-1.0, 1.0, 5)
    velocity = np.array([0.0, 3400.0, 0.0])
    place = np.array([3.8e6, 0.0, 0.0]) + times[:, None] * velocity
    found = geometric(PositionTable(times, place, np.tile(velocity, (5, 1))), np.zeros(3), lt_s(body_observes))

    moved = found.positions[2] - place[2]
    np.testing.assert_allclose(moved, [0.0, 3400.0 * 3.8e6 / SPEED_OF_LIGHT, 0.0], atol=1e-3)
