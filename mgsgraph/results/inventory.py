"""What a case holds, with warnings, as text for the terminal; no adjustment is made."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.adjust import Prediction, predict
from mgsgraph.analysis.geometry_checks import convergence, deviating_heights, misplaced_profiles
from mgsgraph.analysis.statistics import local_sigmas
from mgsgraph.case.case_file import decode, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.reading import Case, picture_of, read_altimetry, read_profile
from mgsgraph.case.schema import CaseInput
from mgsgraph.errors import Unmeasured, WeakNetwork, command_line
from mgsgraph.files.labels.accuracy import accuracy_of, sigmas_in_words
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.altimetry import require_on_body
from mgsgraph.geometry.footprint import eastward_bounds, footprint, overlaps
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, by_value, finite_rows, sigmas_of
from mgsgraph.geometry.trajectory import utc_of_tdb
from mgsgraph.names import grouped
from mgsgraph.network import Network, NodePrior, Pass, PointClass, SharedKind
from mgsgraph.network.connectivity import (
    WEAKEST,
    Connectivity,
    connectivity,
    connectivity_warnings,
    link_statement,
    network_footprints,
)
from mgsgraph.network.corrections import support_of, useful_rays
from mgsgraph.network.duplicates import duplicates
from mgsgraph.network.footprints import crossings, footprints_in_images
from mgsgraph.network.joining import mounting_angles
from mgsgraph.network.observations import coverage
from mgsgraph.results.places import crossings_section
from mgsgraph.results.section import ROWS, Section, table_of
from mgsgraph.results.summary import points_in_words
from mgsgraph.results.tables import connectivity_table
from mgsgraph.results.verdict import beyond_priors_statements, range_statements, reading_statements
from mgsgraph.text import length, many, root_mean_square, some, some_of, span, two
from mgsgraph.units import ARCSEC, DEG, KM, MILLISECOND, MM, MRAD

_FEW_POINTS = 6
"""Fewer points than this in an image leave its orientation to the prior."""
_SHORT_SPAN = 0.5
"""Points over less than this share of the lines leave the polynomials to extrapolate."""
_NARROW = 5.0 * DEG
"""Convergence below which heights are poor."""
_OUTLYING = 10.0
"""Standard deviations from the median of their image beyond which ranges are named."""
_MEDIAN_DEVIATION = 0.6745
"""Median of the modulus of a normal error, in its standard deviations."""
_NAMED = 5
"""How many of a kind are named."""
_WARNINGS = 7
"""Warnings that are printed without details."""


def inventory(case: Case, details: bool = True) -> str:
    """What a case holds, as text: warnings and figures in a few lines, or with all tables."""
    network, warnings = case.network, [note.removesuffix(".") for note in case.notes]
    try:
        prediction = predict(network, case.settings)
    except WeakNetwork as error:  # tell all the rest as if 1 km and 10 mrad were known of what is not
        warnings.append(str(error))
        prediction = predict(_with_wide_priors(network), case.settings)
    connected = connectivity(network, network_footprints(network, prediction.places))
    warnings += _weaknesses(network, prediction, connected)
    heading = (
        f"{case.name}: {len(network.images)} images, {len(network.points)} points, {network.rays.point.size} image "
        f"measurements, {network.ranges.point.size} ranges"
    )
    points, reading_remarks = _points_section(network, prediction), reading_statements(network.images)
    priors = [(network.images[j], network.priors[j]) for j in np.flatnonzero(network.with_polynomial)]
    if not details:
        count = len(reading_remarks)
        remarks = [f"{many(count, 'remark')} on the images: --details."] if count else []
        ranges = points.sentences if network.ranges.point.size else []
        sentences = [*_expected_precision(network, prediction), *ranges, *link_statement(connected)]
        sentences += [*prior_statements(priors, sources=False), *remarks]
        warnings = warnings[:_WARNINGS] + ([f"{len(warnings) - _WARNINGS} more: --details"] if len(warnings) > _WARNINGS
                                           else [])
        return _as_text([Section("", f"{heading}\n", [f"Warning: {warning}" for warning in warnings]
                                 or ["No warnings."]),
                         Section("", "", sentences)]).replace("\n\n", "\n")  # fmt: skip
    rows = connected.links if connected.links.size <= ROWS else connected.spine[:WEAKEST]
    pairs = connectivity_table(connected).take(rows)
    return _as_text([
        Section("", heading, tables=[_images_table(network.images, network)]),
        Section("", sentences=[*reading_remarks, *defining_values(network.images), *prior_statements(priors)]), points,
        Section("", "Connections (points in common)", link_statement(connected), [pairs]),
        Section("", tables=[_unknowns_table(network)]),
        Section("", sentences=_terrain_sentences(network, prediction.places)),
        Section("", "Warnings", warnings or ["none"]),
    ])  # fmt: skip


def prior_statements(priors: Iterable[tuple[PushbroomImage, OrientationPrior]], sources: bool = True) -> Iterator[str]:
    """A-priori sigmas of orbit and pointing, a sentence for each mission, beside the published accuracy, with its
    sources or without.
    """
    groups = Counter(
        (sigmas_in_words(sigmas[:3], [angle / MRAD for angle in sigmas[3:]]), accuracy_of(image.mission))
        for image, prior in priors if (sigmas := prior.sigmas[0].tolist())
    )  # fmt: skip
    for (stated, published), count in groups.items():
        published_sigmas = sigmas_in_words([published.orbit], published.pointing)
        published_text = published.words if sources else f"{published.mission}: {published_sigmas}"
        stated = " of" if stated == published_sigmas else f": {stated}; usual for"
        yield f"A-priori sigmas of {many(count, 'image')}{stated} {published_text}."


def _expected_precision(network: Network, prediction: Prediction) -> Iterator[str]:
    """How well each class of points will be known, and its nominal residuals."""
    groups = [(f"{each.name.lower()} points", points) for each, points in points_in_words(network)]
    for name, points in [*groups, ("checkpoints", network.points.checkpoints)]:
        determined = points[np.all(np.isfinite(prediction.covariances[points]), axis=(1, 2))]
        if not determined.size:
            continue
        sigmas = np.median(local_sigmas(prediction.covariances[determined], prediction.places[determined]), axis=0)
        residuals = prediction.residuals[np.isin(network.rays.point, determined)]
        finite = residuals[finite_rows(residuals)]
        fit = ", before adjustment: residuals {} x {} px (rms)".format(*map(two, root_mean_square(finite, 0).tolist()))
        yield (
            f"{points.size} {name}{fit if finite.size else ''}. Expected median sigma: "
            f"{length(float(np.hypot(*sigmas[:2])))} horizontal, {length(float(sigmas[2]))} vertical."
        )


def _as_text(sections: Iterable[Section]) -> str:
    return "\n\n".join(filter(None, (section.text(None) for section in sections)))


def images_inventory(path: Path, unmeasured: Unmeasured | None = None) -> str | None:
    """The images of a case without measures, which of them overlap, and the laser shots in them; None of a case that
    has measures. InputError where a file of shots can't be used.

    A case has none either whose tie points are still to be matched (the folder of their network isn't there yet), or
    of which reading has found so: `unmeasured`, which is raised again where it names tie points.
    """
    case_input = decode(path)
    networks = [group.network for group in case_input.tie_groups if (path.parent / group.network).parent.is_dir()]
    if unmeasured is None and case_input.measured and (networks or not case_input.tie_groups
                                                       or case_input.ground_control):
        return None
    if unmeasured is not None and networks:
        raise unmeasured
    names = [image.name for image in case_input.images]
    of_passes = members(case_input.passes, names, str(path))
    images, in_passes = read_images(case_input, case_input.orientations, of_passes, path), set().union(*of_passes)
    priors = [pair for j, pair in enumerate(zip(images, case_input.priors(str(path), images), strict=True))
              if j not in in_passes]
    common = overlaps([footprint(image) for image in images])
    pairs = [
        f"{images[i].name} and {images[j].name} overlap by {area / KM**2:.2f} km^2, {share:.0%} of the smaller one"
        for (i, j), area, share in zip(common.pairs.tolist(), common.areas.tolist(), common.shares.tolist(),
                                       strict=True)
    ]
    without_pixels = [entry.name for entry in case_input.images if picture_of(entry, path.parent) is None]
    folder = next((path.parent / group.network for group in case_input.tie_groups), None)
    sentences = [f"Its tie points, {folder}, are not there yet."] if folder is not None else []
    next_step = command_line("match", path, "--out", "MATCHES" if folder is None else folder.parent)
    if not pairs:
        next_step = "an image that overlaps (mgsgraph new)"
    elif without_pixels:
        next_step = f'pixels = "FILE" in [[images]] for {some(without_pixels)}, then {next_step}'
    else:
        sentences.append(f"Ready for match: {many(len(images), 'image')} with pixels, {many(len(pairs), 'overlap')}.")
    return _as_text([
        Section("", f"{case_input.name}: {many(len(images), 'image')}, no measurements in them", [
            *sentences, f"It needs tie points, ground control, or laser shots measured in images; next: {next_step}",
        ], [_images_table(images)]),
        Section("", sentences=[*reading_statements(images), *defining_values(images), *prior_statements(priors)]),
        Section("", "Overlaps", pairs or ["none"]), Section("", "", _laser_files(case_input, images, path.parent)),
    ])  # fmt: skip


def _laser_files(case_input: CaseInput, images: Sequence[PushbroomImage], folder: Path) -> list[str]:
    """What files of laser shots hold and how much of it falls in images."""
    sentences, body = list[str](), images[0].body
    for entry in case_input.shots:
        shots = read_profile(entry, folder)
        require_on_body(shots.footprints, body, shots.source)
        registration = footprints_in_images(images, shots.chosen(shots.ground))
        sentences.append(f"{entry.file}: {many(shots.times.size, 'shot')} of {shots.altimeter.name}")
        sentences += crossings_section(registration, crossings(registration)).sentences
    for cloud in case_input.altimetry:
        returns = read_altimetry(cloud, folder, body)
        count = f"{many(len(returns.ids), 'ground return')} in {many(len(returns.profiles), 'profile')}"
        sentences.append(f"{cloud.file}: {count}, for control by relief")
    return sentences


def _with_wide_priors(network: Network) -> Network:
    """The network with wide sigmas, 1 km and 10 mrad, in place of infinite ones."""
    wide = np.repeat([1e3, 1e-2], 3)
    priors = tuple(OrientationPrior(np.where(np.isinf(prior.sigmas), wide, prior.sigmas)) for prior in network.priors)
    passes = tuple(
        replace(pass_, prior=replace(prior, sigmas=np.where(np.isinf(prior.sigmas), wide, prior.sigmas)))
        if isinstance(prior := pass_.prior, NodePrior)
        else pass_
        for pass_ in network.passes
    )
    return replace(network, priors=priors, passes=passes)


def _terrain_sentences(network: Network, places: Array) -> list[str]:
    """Terrain model as control: how many tie points lie on it, with what sigma."""
    surface = network.surface
    if surface is None:
        return []
    sigmas, ties = surface.sigmas[np.isfinite(surface.sigmas)], network.points.classes == PointClass.TIE
    covered, name = coverage(surface.grid, places[ties]), f"Terrain model {surface.grid.source}"
    sentences = [f"{name}: {sigmas.size} points lie on it, height sigma {span(sigmas)} m"] if sigmas.size else []
    if covered.words:
        sentences.append(f"{name}: of {covered.total} tie points it leaves out {covered.words}: these have no such row")
    return sentences


def _unknowns_table(network: Network) -> Table:
    """Unknowns beside points and images' polynomials: passes and how their cameras are mounted, what images share, the
    terrain model's own; with a-priori sigmas.
    """
    names, rows = network.image_names, list[tuple[str, str, str]]()
    for pass_ in network.passes:
        sigmas = pass_.prior.node_sigmas(np.zeros(len(pass_.nodes)))[0]
        rows.append((
            f"pass {pass_.name}, {len(pass_.nodes)} orientation images "
            f"({pass_.nodes.basis}) every {pass_.nodes.spacing:.3g} s", some_of(names, pass_.images),
            _sigmas_text(sigmas),
        ))  # fmt: skip
        rows += _mounting_rows(pass_, names)
    for shared in network.shared:
        scale, unit = shared.kind.reported
        sigmas = shared.sigmas / scale
        rows.append((shared.name, some_of(names, shared.images),
                     f"{', '.join(f'{sigma:.3g}' for sigma in sigmas)} {unit}"))
    for term in () if network.surface is None else network.surface.terms:
        size = f"{term.sigma / ARCSEC:.3g} arcsec" if term.unit == "rad" else f"{term.sigma:.3g} {term.unit}"
        rows.append((term.name, "terrain model", size))
    unknowns, owners, prior_texts = ([row[k] for row in rows] for k in range(3))
    return table_of("unknowns", {"unknown": unknowns, "of": owners, "known": prior_texts})


def _mounting_rows(pass_: Pass, names: Sequence[str]) -> list[tuple[str, str, str]]:
    """How the cameras of a pass are turned against that of its first image."""
    mountings = np.zeros((0, 3)) if pass_.axes is None else mounting_angles(pass_.axes) / DEG
    images_by_angles = grouped(
        (", ".join(f"{angle:+.4f}" for angle in angles), names[j])
        for j, angles in zip(pass_.images.tolist(), mountings.tolist(), strict=False)
    )
    first, *others = images_by_angles.items() or [("", [])]
    return [(f"mounted at {angles_text} deg (about x, y, z of {first[1][0]})", some(mounted), "")
            for angles_text, mounted in others]  # fmt: skip


def _images_table(images: Sequence[PushbroomImage], network: Network | None = None) -> Table:
    """Size, place, and how the orientation is adjusted."""
    projections = [image.image_to_ground(*image.middle) for image in images]
    spacing = np.array([np.linalg.norm(derivative[0], axis=0) for _, derivative in projections])
    bounds = np.array([eastward_bounds(footprint(image).outline) for image in images])
    return table_of("inventory_images", {
        "spacing_{}": spacing, "longitude_{}": bounds[:, 0::2], "latitude_{}": bounds[:, 1::2],
        "orientation": None if network is None else [_orientation_text(network, j) for j in range(len(images))],
    }, images)  # fmt: skip


def defining_values(images: Sequence[PushbroomImage]) -> list[str]:
    """Sentences with the constants and times that decide the geometry of images, for a look by eye: much of the input
    has no second statement that they could be held against.
    """
    names_by_text = dict[str, list[str]]()
    for image in images:
        interior, timing, body = image.interior, image.timing, image.body
        pitch = 1.0 / float(np.linalg.norm(interior.to_pixel[1, 1:]))
        period = f"{timing.periods.min() / MILLISECOND:.7g}"
        if timing.periods.size > 1:
            period += f" .. {timing.periods.max() / MILLISECOND:.7g}"
        distortion = type(interior.distortion).__name__.removesuffix("Distortion")
        names_by_text.setdefault(
            f"focal length {interior.focal_length / MM:.7g} mm ({distortion or 'no'} distortion), detector pixels of "
            f"{1e6 * pitch:.5g} micrometers, {interior.sample_summing:g} per sample, the first one "
            f"{interior.first[1]:g}, principal point at pixel {interior.centre[1]:.7g}; {period} ms per line; body of "
            f"{body.equatorial / KM:.9g} and {body.polar / KM:.9g} km", [],
        ).append(image.name)  # fmt: skip
    sentences = [f"{some(names)}: {text}." for text, names in names_by_text.items()]
    first_lines = [f"{image.name} {utc_of_tdb(image.span[0]):%Y-%m-%dT%H:%M:%S.%f}"[:-3] for image in images]
    return [*sentences, f"First lines (UTC): {some(first_lines)}."]


def _orientation_text(network: Network, j: int) -> str:
    """How an image is adjusted."""
    owner, prior, held = int(network.pass_of[j]), network.priors[j], "held; " if network.held[j] else ""
    if owner >= 0:
        return f"{held}pass {network.passes[owner].name}"
    return f"{held}degree {prior.degree}, sigma {_sigmas_text(prior.sigmas[0])}"


def _sigmas_text(sigmas: Array) -> str:
    """Sigmas (6,) of positions in m and rotations in rad, as text."""
    return f"{span(sigmas[:3])} m, {span(sigmas[3:] / ARCSEC)} arcsec"


def _points_section(network: Network, prediction: Prediction) -> Section:
    """Points by class, with expected sigmas and residuals; ranges."""
    ray_counts, sentences, rows = network.ray_counts, list[str](), []
    sigmas = sigmas_of(prediction.covariances)
    for _, points in network.of_class():
        determined = points[finite_rows(sigmas[points])]
        expected = sigmas[determined].mean(axis=0) if determined.size else np.full(3, np.nan)
        residuals = prediction.residuals[np.isin(network.rays.point, determined)]
        rms = (root_mean_square(residuals[finite_rows(residuals)], 0) if residuals.size
               else np.full(2, np.nan))
        rows.append((points.size, np.count_nonzero(network.points.kinds[points] == PointKind.FREE),
                     ray_counts[points].min(), ray_counts[points].max(), *expected, *rms))  # fmt: skip
    values = np.array(rows, dtype=np.float64).reshape(-1, 9)
    table = table_of("inventory_points", {
        "class": [point_class.name.lower() for point_class, _ in network.of_class()],
        "count": values[:, 0].astype(np.int64), "free": values[:, 1].astype(np.int64), "rays_{}": values[:, 2:4],
        "sigma_{}": values[:, 4:7], "residual_{}": values[:, 7:],
    })  # fmt: skip
    if network.ranges.point.size:
        residuals, ranges = prediction.range_residuals, network.ranges.values / KM
        sentences.append(
            f"{residuals.size} laser ranges of {ranges.min():.1f} to {ranges.max():.1f} km, before adjustment: "
            f"residuals {two(root_mean_square(residuals))} m (rms), mean {two(float(residuals.mean()))} m."
        )
    return Section("", sentences=sentences or ["no laser ranges"], tables=[table])


def _weaknesses(network: Network, prediction: Prediction, connected: Connectivity) -> list[str]:
    """Sentences about what will be poorly determined."""
    points, ranged, undetermined = network.points, network.ranges.point, network.undetermined
    warnings = [duplicate.sentence for duplicate in duplicates(network)] + connectivity_warnings(connected)
    warnings += (beyond_priors_statements(network, prediction.residuals) + _poorly_covered(network)
                 + unsupported_nodes(network))
    warnings += mounting_warnings(network) + range_statements(network, prediction.range_residuals)
    for indices, problem in (
        (np.flatnonzero(undetermined), "points have fewer than two rays and no a-priori place, and stay out"),
        (np.flatnonzero(np.any(np.isnan(prediction.places), axis=1) & ~undetermined),
         "points have parallel rays, and stay out"),
        (ranged[outlying_ranges(network, prediction.range_residuals)],
         f"ranges lie more than {_OUTLYING:.0f} robust standard deviations from the others of their image"),
        (np.setdiff1d(np.flatnonzero(points.classes == PointClass.LASER), ranged) if ranged.size else ranged,
         "laser points have no range (no simultaneous image)"),
    ):  # fmt: skip
        warnings += [f"{indices.size} {problem}: {some_of(points.ids, indices, _NAMED)}"] if indices.size else []
    heights = deviating_heights(network, prediction.places, prediction.covariances)
    if heights.points.size:
        farthest = length(abs(float(heights.deviations[0])))
        warnings.append(
            f"{many(heights.points.size, 'point')} up to {farthest} above or below neighbors (false matches?): "
            f"{some_of(points.ids, heights.points, _NAMED)}"
        )
    warnings += [
        f"{many(profile.shots, 'laser shot')} of {profile.name} lie {abs(profile.angle) / DEG:.1f} deg along the "
        "flight from where the camera looked: a wrong clock, or a wrong profile"
        for profile in misplaced_profiles(network)
    ]  # fmt: skip
    angles = convergence(network, np.flatnonzero(points.classes == PointClass.TIE))
    if np.any(angles < _NARROW):
        warnings.append(
            f"rays of {np.count_nonzero(angles < _NARROW)} tie points converge by less than {_NARROW / DEG:.0f} deg "
            f"(least {angles.min() / DEG:.2f} deg): their heights are poorly known"
        )
    controlled = network.surface is not None or network.stereo is not None
    if not (controlled or np.any(points.kinds != PointKind.FREE) or np.any(network.held)):
        warnings.append(
            "no laser, no ground control, no held image: only the a-priori sigmas of the orientation hold the block"
        )
    return warnings


def outlying_ranges(network: Network, values: Array) -> Index:
    """Ranges far from the others of their image, with the nominal orientation: its errors are common to them, or drift
    along them, and so are in the spread that is estimated from the median deviation.
    """
    ranges, outlying = network.ranges, np.zeros(values.size, dtype=bool)
    for _, of_image in by_value(ranges.image):
        offsets = np.abs(values[of_image] - np.median(values[of_image]))
        outlying[of_image] = offsets > _OUTLYING * np.hypot(ranges.sigmas[of_image],
                                                            np.median(offsets) / _MEDIAN_DEVIATION)
    return np.flatnonzero(outlying)


def _poorly_covered(network: Network) -> list[str]:
    """Images outside passes, whose images lean on each other, with few points or points on few of their lines."""
    few_points, short_span = list[str](), list[str]()
    for j in np.flatnonzero(network.pass_of < 0).tolist():
        image, lines = network.images[j], network.rays.places[network.rays.image == j, 0]
        if lines.size < _FEW_POINTS:
            few_points.append(f"{image.name} ({lines.size})")
        elif np.ptp(lines) < _SHORT_SPAN * image.lines:
            short_span.append(f"{image.name} ({lines.min():.0f} .. {lines.max():.0f} of {image.lines})")
    return [
        f"{heading}: {some(images)}"
        for heading, images in (
            (f"images with fewer than {_FEW_POINTS} points, whose orientation is mostly its prior", few_points),
            ("images whose points span few lines, and whose orientation is extrapolated elsewhere", short_span),
        )
        if images
    ]


def mounting_warnings(network: Network) -> list[str]:
    """Sentences about passes all of whose cameras have an unknown boresight, or lever arm: what these have in common is
    separable from the pass's own attitude, or position, by the a-priori sigmas alone.
    """
    warnings = []
    estimated = [unknown for unknown in network.shared if unknown.name not in network.considered]
    for kind, unknowns, counterpart in (
        (SharedKind.CAMERA_BORESIGHT, "boresights", "attitude"), (SharedKind.CAMERA_LEVER_ARM, "lever arms", "position")
    ):  # fmt: skip
        estimated_images = {j for unknown in estimated if unknown.kind is kind for j in unknown.images.tolist()}
        passes = [pass_.name for pass_ in network.passes if estimated_images.issuperset(pass_.images.tolist())]
        if passes:
            warnings.append(
                f"{unknowns} of all cameras of {some(passes)} are unknown beside the pass's own "
                f"{counterpart}: only the a-priori sigmas separate what they have in common from it; leave one "
                "camera out as the reference"
            )
    return warnings


def unsupported_nodes(network: Network) -> list[str]:
    """Sentences about passes with nodes near which hardly anything was measured."""
    warnings = []
    for k, pass_ in enumerate(network.passes):
        support = support_of(network.passes[k].nodes, useful_rays(network, k))
        if support.gaps.size:
            warnings.append(
                f"pass {pass_.name}: fewer than {support.least} rays near {support.gaps.size} of its "
                f"{len(pass_.nodes)} nodes, between others that have them: closer than the data supports, and refused "
                "by adjust"
            )
        if outer := int(np.count_nonzero(support.unobserved)) - support.gaps.size:
            warnings.append(
                f"pass {pass_.name}: no rays near {many(outer, 'node')} at its ends: there it follows its prior"
            )
    return warnings
