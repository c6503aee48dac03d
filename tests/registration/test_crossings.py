"""Profiles over images: against the places of a simulated track, and against LOLA over a pair of LROC NAC images."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import networks
import numpy as np
import pytest

from mgsgraph.analysis.places import View
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.shots import read_shots
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.altimetry import LOLA, AltimeterShots, joined_shots
from mgsgraph.geometry.records import frozen_mask
from mgsgraph.geometry.trajectory import utc_of_tdb
from mgsgraph.network.footprints import Registration, crossings, footprints_in_images
from mgsgraph.project.reading import OrientedImages, ShotChoice, search_shots
from mgsgraph.results.places import crossings_section, crossings_table, selection_table


def along_and_later() -> tuple[Registration, AltimeterShots]:
    """A track along the first image of a pair, in the middle of its columns, and the same a day later as noise."""
    image = networks.pair(ties=20, shots=8).images[0]
    lines = np.linspace(-200.0, image.lines + 200.0, 60)
    inside = np.clip(lines, 0.0, image.lines)
    ground, _ = image.image_to_ground(inside, np.full(60, 0.5 * image.samples))
    ground += np.where(lines == inside, 0.0, 5e4)[:, None]  # off the image at its ends
    times = image.timing.at(inside)[0] + image.trajectory.epoch + (lines - inside) * 0.01
    nothing, numbers = np.full(120, np.nan), np.arange(1, 61)
    shots = AltimeterShots(
        source="made up", orbits=np.repeat([7, 19], 60), frames=np.tile(numbers, 2), shots=np.ones(120),
        times=np.concatenate([times, times + 86400.0]), footprints=np.concatenate([ground, ground]),
        areoid_radii=nothing, ranges=np.full(120, 4e5), range_corrections=nothing, spacecraft=np.full((120, 3), np.nan),
        off_nadir=np.repeat([0.01, 0.4], 60), ground=frozen_mask(np.ones(120, dtype=bool), "ground", 120),
        channels=np.ones(120), clocks=nothing, pulses=nothing,
    )  # fmt: skip
    return footprints_in_images([image], shots), shots


def test_the_profile_that_was_taken_along() -> None:
    over, _ = along_and_later()
    within = np.count_nonzero(over.inside[0, :60])
    first, second = crossings(over)

    assert 40 < within < 60
    assert (first.profile, first.inside, first.simultaneous, first.seconds) == ("7", within, within, 0.0)
    assert (second.profile, second.inside, second.simultaneous) == ("19", within, 0)
    assert 86390.0 < second.seconds < 86400.0
    assert np.array_equal(over.chosen, np.flatnonzero(over.inside[0]))
    assert np.array_equal(over.inside[0, :60], over.inside[0, 60:])
    assert len(crossings_table((first, second)).text()) == 3
    assert f"{2 * within} shots" in crossings_section(over, (first, second)).sentences[0]


def test_a_selection_is_read_back(tmp_path: Path) -> None:
    over, shots = along_and_later()
    selection_table(over).write_csv(tmp_path / "selection.csv")
    back, chosen = read_shots(tmp_path / "selection.csv"), shots.chosen(over.chosen)

    assert back.ids == chosen.ids
    assert back.altimeter is chosen.altimeter
    for name in ("times", "ranges", "areoid_radii", "off_nadir", "ground", "channels", "spacecraft", "pulses"):
        np.testing.assert_allclose(getattr(back, name), getattr(chosen, name), rtol=1e-15)
    np.testing.assert_allclose(back.footprints, chosen.footprints, atol=1e-8)


def test_utc_of_a_selection_is_the_archives(shared_data: Path) -> None:
    """ODE's own UTC, to the millisecond; TDB - TT, 1.7 ms at the most, is not in it."""
    path = shared_data / "lro_nac_lola" / "lidarPoints.csv"
    shots = read_shots(path)
    image, n = along_and_later()[0].images[0], shots.times.size
    over = Registration((image,), shots, np.zeros((1, n, 2)), np.ones((1, n), dtype=bool), np.ones((1, n)))
    rows = [row.split(",", 1)[0].strip() for row in path.read_text(encoding="utf-8").splitlines()]
    utc = next(one.values for one in selection_table(over).columns if one.key == "utc")
    assert len(utc) == len(rows)
    off = np.array(utc, dtype="datetime64[us]") - np.array([row[:26] for row in rows], dtype="datetime64[us]")
    assert np.abs(off).max() <= np.timedelta64(501, "us")


def test_lola_over_a_pair_of_lroc_nac(shared_data: Path, tmp_path: Path) -> None:
    """7,329 shots on 8 dates in NAC-L (its README; half a pixel at its edges is 5 of them), none in NAC-R, whose ground
    the box of the query ends before.
    """
    folder = shared_data / "lro_nac_hadley"
    images = tuple(read_isd(folder / f"observationImage{side}.isd", side) for side in "LR")
    seen = OrientedImages(tuple(map(View, images)))
    over = search_shots([folder / "RDR_hadley_LOLA.csv.gz"], seen, ShotChoice())
    found = crossings(over)

    assert over.chosen.size == sum(one.inside for one in found)
    assert abs(over.chosen.size - 7329) <= 6
    assert len({one.profile[:10] for one in found}) == 8
    assert {one.image for one in found} == {"L"}
    assert not any(one.simultaneous for one in found)
    assert all(300.0 < one.seconds / 86400.0 < 740.0 for one in found)
    some = ShotChoice(("2010-05-23", "2010-10-07"), off_nadir=17.0)
    selection_table(replace(over, inside=over.inside & some.of(over.shots))).write_csv(tmp_path / "s.csv")
    again = search_shots([tmp_path / "s.csv"], seen, ShotChoice())
    assert [(one.profile, one.inside) for one in crossings(again)] == [
        (one.profile, one.inside) for one in found if one.profile in ("2010-05-23T14:02", "2010-10-07T03:36")
    ]
    assert again.shots.altimeter is LOLA
    with pytest.raises(InputError, match=r"radii of 3,39\d.* km .*1\.95"):
        search_shots([shared_data / "mola_pedr_ode" / "insight_topography.csv"], seen, ShotChoice())


def test_files_that_overlap_have_each_shot_once() -> None:
    _, shots = along_and_later()
    half = shots.chosen(np.arange(90))
    joined = joined_shots([half, shots])
    assert joined.times.size == 120
    assert joined_shots([half, shots.chosen(np.arange(80, 120))]).ids == joined.ids
    alike = replace(shots.chosen(np.arange(60, 120)), orbits=np.full(60, 7))  # lines of another file
    assert len(set(joined_shots([shots.chosen(np.arange(60)), alike]).ids)) == 120
    with pytest.raises(InputError, match="several altimeters"):
        joined_shots([shots, replace(shots, altimeter=LOLA)])


def test_dates_hold_both_days() -> None:
    _, shots = along_and_later()
    day, next_day = (f"{utc_of_tdb(shots.times[k]):%Y-%m-%d}" for k in (0, 60))
    minute = f"{utc_of_tdb(shots.times[60]) - timedelta(minutes=1):%Y-%m-%dT%H:%M}"

    def count(*dates: str) -> int:
        return int(np.count_nonzero(ShotChoice((dates[0], dates[1])).of(shots)))

    assert (count(day, day), count(next_day, next_day), count(day, next_day)) == (60, 60, 120)
    assert (count(minute, next_day), count(day, minute)) == (60, 60)
    for wrong in ((next_day, day), ("May", "June"), ("1971-05-01", day)):
        with pytest.raises(InputError, match="dates"):
            count(*wrong)
