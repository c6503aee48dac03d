"""What a case holds and where it is weak, as text for the terminal; nothing is solved for it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsgraph.adjustment.nominal import Prediction, predict
from mgsgraph.case.case_file import decode
from mgsgraph.case.images import read_images
from mgsgraph.case.passes import members
from mgsgraph.case.reading import Case, picture_of, read_altimetry, read_profile
from mgsgraph.case.schema import CaseInput
from mgsgraph.errors import Unmeasured, WeakNetwork
from mgsgraph.files.tie_points import PointKind
from mgsgraph.geometry.altimetry import require_on_body
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.footprint import footprint, overlaps
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import Network, NodePrior, PointClass, Surface
from mgsgraph.network.connectivity import Connectivity, connectivity, network_footprints
from mgsgraph.network.connectivity_words import (
    connectivity_warnings,
    cut_image_statement,
    link_statement,
    weakest_joints,
)
from mgsgraph.network.terrain_control import coverage
from mgsgraph.registration.crossings import shots_over_images
from mgsgraph.results.crossings import crossing_sentences
from mgsgraph.results.input_remarks import beyond_priors_statements, range_statements, reading_statements
from mgsgraph.results.passes import bare_nodes, mounting_warnings, passes_inventory
from mgsgraph.text import many, root_mean_square, some, some_of
from mgsgraph.units import DEG, KM, MRAD

_FEW_POINTS = 6
"""Fewer points than this in an image leave its orientation to the prior."""
_SHORT = 0.5
"""Points over less than this share of the lines leave the polynomials to extrapolate."""
_NARROW = 5.0 * DEG
"""Convergence below which heights are poor."""
_WILD = 10.0
"""Standard deviations from the median of their image beyond which ranges are named."""
_MEDIAN_DEVIATION = 0.6745
"""Median of the modulus of a normal error, in its standard deviations."""
_LISTED = 24
"""Images up to which each is listed with its partners."""
_ISLANDS = 9
"""Islands named."""
_NAMED = 5
"""How many of a kind are named."""


def inventory(case: Case) -> str:
    """Images and their coverage, points, shots, connectivity, and expected weak spots; several lines of text."""
    network = case.network
    weak: list[str] = []
    try:
        prediction = predict(network, case.settings)
    except WeakNetwork as error:  # tell all the rest as if 1 km and 10 mrad were known of what is not
        weak.append(str(error))
        prediction = predict(_with_priors(network), case.settings)
    connected = connectivity(network, network_footprints(network, prediction.places))
    weak += _weak_spots(network, prediction, connected)
    parts = [
        f"{case.name}: {len(network.images)} images, {len(network.points)} points, {network.rays.point.size} image "
        f"measurements, {network.ranges.point.size} ranges",
        *case.notes,
        _images(network),
        _points(network, prediction),
        _connections(connected),
        *_pulses(case),
        *([_shared(network)] if network.shared else []),
        *([passes_inventory(network)] if network.passes else []),
        *([_terrain(network, network.surface, prediction.places)] if network.surface is not None else []),
        "Weak spots\n" + "\n".join(f"  - {line}" for line in weak or ["none seen"]),
    ]
    return "\n\n".join(parts)


def images_inventory(path: Path, unmeasured: Unmeasured | None = None) -> str | None:
    """The images of a case without measures, which of them overlap, and the laser shots in them; None of a case that
    has measures. InputError where a file of shots can't be used.

    A case has none either whose tie points are still to be matched (the folder of their network isn't there yet), or
    of which reading has found so: `unmeasured`, which is raised again where it names tie points.
    """
    wanted = decode(path)
    matched = [group.network for group in wanted.tie_groups if (path.parent / group.network).parent.is_dir()]
    if unmeasured is None and wanted.measured and (matched or not wanted.tie_groups or wanted.ground_control):
        return None
    if unmeasured is not None and matched:
        raise unmeasured
    names = [image.name for image in wanted.images]
    images, _ = read_images(wanted, wanted.orientations, members(wanted.passes, names, str(path)), path)
    found = overlaps([footprint(image) for image in images])
    pairs = [
        f"  {images[i].name} and {images[j].name} overlap by {area / KM**2:.2f} km^2, {share:.0%} of the smaller one"
        for (i, j), area, share in zip(found.pairs.tolist(), found.areas.tolist(), found.shares.tolist(), strict=True)
    ]
    bare = [entry.name for entry in wanted.images if picture_of(entry, path.parent) is None]
    folder = next((f"{path.parent / group.network}" for group in wanted.tie_groups), None)
    into = "MATCHES" if folder is None else str(Path(folder).parent)
    what = f"mgsgraph match {path} --out {into}" if pairs else "an image that overlaps, as well (mgsgraph new)"
    what = f'pixels = "FILE" in [[images]] for {some(bare, len(bare))}, then {what}' if bare and pairs else what
    return "\n".join([
        f"{wanted.name}: {many(len(images), 'image')}, no measures in them\n", "Images",
        *(line for image in images for line in _image(image)),
        *(f"  {sentence}" for sentence in reading_statements(images)), "", "Overlaps", *(pairs or ["  none"]), "",
        *_laser_files(wanted, images, path.parent),
        *([f"Its tie points, {folder}, are not there yet."] if folder is not None else []),
        *([f"Ready for match: {many(len(images), 'image')} with pixels, {many(len(pairs), 'overlap')}."]
          if pairs and not bare else []),
        f"To be adjusted it needs tie points, ground control, or laser shots measured in images; next: {what}",
    ])


def _laser_files(wanted: CaseInput, images: Sequence[PushbroomImage], folder: Path) -> list[str]:
    """What files of laser shots hold and how much of it falls in images."""
    said, body = list[str](), images[0].body
    for entry in wanted.shots:
        shots = read_profile(entry, folder)
        require_on_body(shots.footprints, body, shots.source)
        over = shots_over_images(images, shots.chosen(shots.ground))
        said.append(f"  {entry.file}: {many(shots.times.size, 'shot')} of {shots.altimeter.name}")
        said += [f"    {sentence}" for sentence in crossing_sentences(over, over.crossings())]
    for cloud in wanted.altimetry:
        found = read_altimetry(cloud, folder, body)
        count = f"{many(len(found.ids), 'ground return')} in {many(len(found.profiles), 'profile')}"
        said.append(f"  {cloud.file}: {count}, for control by relief")
    return ["Laser", *said, ""] if said else []


def _with_priors(network: Network) -> Network:
    """The network with wide sigmas, 1 km and 10 mrad, in place of infinite ones."""
    wide = np.repeat([1e3, 1e-2], 3)
    priors = tuple(OrientationPrior(np.where(np.isinf(prior.sigmas), wide, prior.sigmas)) for prior in network.priors)
    passes = tuple(
        replace(one, prior=replace(prior, sigmas=np.where(np.isinf(prior.sigmas), wide, prior.sigmas)))
        if isinstance(prior := one.prior, NodePrior)
        else one
        for one in network.passes
    )
    return replace(network, priors=priors, passes=passes)


def _terrain(network: Network, surface: Surface, places: Array) -> str:
    """Terrain model as control: how many tie points lie on it, with what sigma; its own unknowns."""
    on = np.isfinite(surface.sigmas)
    sigmas = surface.sigmas[on]
    lines = [f"Terrain model {surface.grid.source}"]
    if sigmas.size:
        extent = f"{sigmas.min():.1f}" + (f" .. {sigmas.max():.1f}" if np.ptp(sigmas) > 0.05 else "")
        lines.append(f"  {sigmas.size} points lie on it, sigma of their heights {extent} m")
    ties = network.points.classes == PointClass.TIE
    covered = coverage(surface.grid, places[ties])
    if covered.words:
        lines.append(f"  of {covered.total} tie points it leaves out {covered.words}: these have no such row")
    terms = [
        f"{term.name} {term.sigma / (MRAD if term.unit == 'rad' else 1.0):.3g} {term.unit.replace('rad', 'mrad')}"
        for term in surface.terms
    ]
    lines.append(f"  unknowns of its own, a-priori sigma: {', '.join(terms) if terms else 'none'}")
    return "\n".join(lines)


def _pulses(case: Case) -> list[str]:
    """Profiles whose ranges and heights get no share of their echoes' widths, which nobody knows; nothing without."""
    names = [Path(one.source).name for one in case.profiles if np.all(np.isnan(one.pulses))]
    if not names:
        return []
    return [f"Laser profiles that don't say how broad their echoes were: {some(names[:_NAMED], len(names))}\n  "
            "sigmas of their ranges and heights are as stated, on slopes too (pulse_share)"]  # fmt: skip


def _shared(network: Network) -> str:
    """Unknowns that images share, with what is known of them beforehand."""
    lines = ["Unknowns that images share"]
    for one in network.shared:
        scale, unit = one.kind.reported
        sigmas = ", ".join(f"{sigma / scale:.3g}" for sigma in one.sigmas)
        kind = "" if one.name == one.kind else f" ({one.kind})"
        names = [network.images[j].name for j in one.images.tolist()]
        lines.append(f"  {one.name}{kind}: a-priori sigma {sigmas} {unit}; {some(names, len(names))}")
    return "\n".join(lines)


def _images(network: Network) -> str:
    lines = ["Images"]
    for j, image in enumerate(network.images):
        lines += _image(image, ", held" if network.held[j] else "")
        lines.append(f"    {_orientation(network, j)}")
    lines += [f"  {sentence}" for sentence in reading_statements(network.images)]
    return "\n".join(lines)


def _image(image: PushbroomImage, held: str = "") -> list[str]:
    """Its size, and where it lies."""
    middle, spacing = _ground_spacing(image)
    longitude, latitude, _ = planetocentric(middle)
    corners = _corners(image)
    return [
        f"  {image.name}: {image.lines} lines x {image.samples} samples{held}; "
        f"line {spacing[0]:.2f} m, sample {spacing[1]:.2f} m on the ground",
        f"    centre {longitude / DEG % 360.0:.4f} E {latitude / DEG:+.4f} N; "
        f"longitude {corners[0, 0]:.4f} .. {corners[1, 0]:.4f}, "
        f"latitude {corners[0, 1]:+.4f} .. {corners[1, 1]:+.4f} deg",
    ]


def _orientation(network: Network, j: int) -> str:
    """How an image is adjusted."""
    owner, prior = int(network.pass_of[j]), network.priors[j]
    if owner >= 0:
        return f"orientation images of pass {network.passes[owner].name}"
    return (
        f"orientation polynomials of degree {prior.degree}, a-priori sigma {_range(prior.sigmas[0, :3])} m and "
        f"{_range(prior.sigmas[0, 3:] / MRAD)} mrad (constant term)"
    )


def _range(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:g} .. {high:g}"


def _ground_spacing(image: PushbroomImage) -> tuple[Array, Array]:
    """Ground point (3,) of the image's middle, and m per line and per sample there, on the ellipsoid."""
    point, derivative = image.image_to_ground(np.array([0.5 * image.lines]), np.array([0.5 * image.samples]))
    return point[0], np.linalg.norm(derivative[0], axis=0)


def _corners(image: PushbroomImage) -> Array:
    """Least and largest longitude and latitude (2, 2) in deg of the image's corners on the ellipsoid."""
    lines = np.array([0.0, 0.0, image.lines, image.lines])
    samples = np.array([0.0, image.samples, 0.0, image.samples])
    places = planetocentric(image.image_to_ground(lines, samples)[0])[:, :2] / DEG
    places[:, 0] = (places[:, 0] - places[0, 0] + 180.0) % 360.0 - 180.0 + places[0, 0] % 360.0
    return np.stack([places.min(axis=0), places.max(axis=0)])


def _points(network: Network, prediction: Prediction) -> str:
    lines = ["Points"]
    counts = network.ray_counts
    sigmas = np.sqrt(np.diagonal(prediction.covariances, axis1=1, axis2=2))
    for point_class, mine in network.of_class():
        kinds = ", ".join(
            f"{count} {kind.name.lower()}"
            for kind in PointKind
            if (count := int(np.count_nonzero(network.points.kinds[mine] == kind)))
        )
        lines.append(
            f"  {mine.size} {point_class.name.lower()} points ({kinds}), {counts[mine].min()} to "
            f"{counts[mine].max()} rays each"
        )
        known = mine[np.all(np.isfinite(sigmas[mine]), axis=1)]
        if not known.size:
            lines.append("    nothing determines the place of any of them: their rays are parallel, or single")
            continue
        expected = sigmas[known].mean(axis=0)
        lines.append(f"    expected mean sigma in x, y, z: {expected[0]:.2f}, {expected[1]:.2f}, {expected[2]:.2f} m")
        rays = np.isin(network.rays.point, known)
        if np.any(rays):
            misfit = prediction.residuals[rays]
            rms = root_mean_square(misfit[np.all(np.isfinite(misfit), axis=1)], 0)
            lines.append(
                f"    with the nominal orientation: image residuals {rms[0]:.2f} lines, {rms[1]:.2f} samples rms"
            )
    if network.ranges.point.size:
        misfit = prediction.range_residuals
        lines.append(
            f"  {misfit.size} laser ranges of {network.ranges.values.min() / KM:.3f} .. "
            f"{network.ranges.values.max() / KM:.3f}"
            f" km; measured minus nominal: mean {misfit.mean():+.3f} m, rms {root_mean_square(misfit):.3f} m"
        )
    else:
        lines.append("  no laser ranges")
    return "\n".join(lines)


def _connections(connected: Connectivity) -> str:
    """Each image with its partners, in small blocks; the links as a whole and the weakest of them."""
    lines = ["Connections (points in common)"]
    if len(connected.names) <= _LISTED:
        lines += [_partners(connected, j) for j in range(len(connected.names))]
    lines += [f"  {sentence}" for sentence in link_statement(connected)]
    if connected.spine.size > 1:
        phrases = [f"    {phrase}" for phrase in weakest_joints(connected)]
        lines += ["  Weakest joints (parts that have no stronger link):", *phrases]
    return "\n".join(lines)


def _partners(connected: Connectivity, image: int) -> str:
    rows = connected.links[np.any(connected.pairs[connected.links] == image, axis=1)]
    rows = rows[np.argsort(-connected.points[rows], kind="stable")]
    other = connected.pairs[rows].sum(axis=1) - image
    partners = [
        f"{connected.points[row]} with {connected.names[j]}" for row, j in zip(rows[:_NAMED], other, strict=False)
    ]
    named = some(partners, rows.size, _NAMED) or "no other image"
    return f"  {connected.names[image]}: {connected.seen[image]} points; {named}"


def _weak_spots(network: Network, prediction: Prediction, connected: Connectivity) -> list[str]:
    """Sentences about what will be poorly determined."""
    found = []
    if len(connected.islands) > 1:
        named = [", ".join(connected.names[j] for j in island[:_NAMED]) for island in connected.islands[1:_ISLANDS]]
        more = f"; and {len(connected.islands) - _ISLANDS} more" if len(connected.islands) > _ISLANDS else ""
        found.append(
            f"the block falls into {len(connected.islands)} islands without common points; apart from the largest: "
            f"{'; '.join(named)}{more}"
        )
    found += [*cut_image_statement(connected), *connectivity_warnings(connected)]
    lost = np.flatnonzero(network.undetermined)
    if lost.size:
        found.append(
            f"{lost.size} points have fewer than two rays and no a-priori place, and stay out: "
            f"{some_of(network.points.ids, lost, _NAMED)}"
        )
    flat = np.flatnonzero(np.any(np.isnan(prediction.places), axis=1) & ~network.undetermined)
    if flat.size:
        names = some_of(network.points.ids, flat, _NAMED)
        found.append(f"the rays of {flat.size} points are parallel, and the points stay out: {names}")
    found += beyond_priors_statements(network, prediction.residuals) + _poor_images(network) + bare_nodes(network)
    found += mounting_warnings(network)
    angle = _convergence(network)
    if np.any(angle < _NARROW):
        found.append(
            f"{np.count_nonzero(angle < _NARROW)} tie points have rays that converge by less than "
            f"{_NARROW / DEG:.0f} deg (least {angle.min() / DEG:.2f} deg): "
            "expect their sigma along the line of sight to be large"
        )
    found += _doubtful_observations(network, prediction)
    controlled = network.surface is not None or network.stereo is not None
    held_down = controlled or np.any(network.points.kinds != PointKind.FREE) or np.any(network.held)
    if not held_down:
        found.append(
            "no laser, no ground control, no held image: only the a-priori sigmas of the orientation hold the block"
        )
    return found


def _doubtful_observations(network: Network, prediction: Prediction) -> list[str]:
    """Ranges far from what the nominal orientation says, and laser points without any."""
    found = range_statements(network, prediction.range_residuals)
    wild = wild_ranges(network, prediction.range_residuals)
    if wild.size:
        names = some_of(network.points.ids, network.ranges.point[wild], _NAMED)
        found.append(
            f"{wild.size} ranges lie more than {_WILD:.0f} robust standard deviations from the others of their image: "
            f"{names}"
        )
    laser = np.flatnonzero(network.points.classes == PointClass.LASER)
    bare = np.setdiff1d(laser, network.ranges.point)
    if network.ranges.point.size and bare.size:
        names = some_of(network.points.ids, bare, _NAMED)
        found.append(f"{bare.size} laser points have no range (no simultaneous image): {names}")
    return found


def wild_ranges(network: Network, values: Array) -> Index:
    """Ranges far from the others of their image, with the nominal orientation: its errors are common to them, or drift
    along them, and so are in the spread that is estimated from the median deviation.
    """
    ranges, wild = network.ranges, np.zeros(values.size, dtype=bool)
    for j in np.unique(ranges.image):
        mine = ranges.image == j
        off = np.abs(values[mine] - np.median(values[mine]))
        wild[mine] = off > _WILD * np.hypot(ranges.sigmas[mine], np.median(off) / _MEDIAN_DEVIATION)
    return np.flatnonzero(wild)


def _poor_images(network: Network) -> list[str]:
    found = []
    for j in np.flatnonzero(network.pass_of < 0).tolist():  # a pass's images lean on each other
        image, mine = network.images[j], network.rays.image == j
        count, lines = int(np.count_nonzero(mine)), network.rays.places[mine, 0]
        if count < _FEW_POINTS:
            found.append(f"image {image.name} has only {count} points: its orientation will mostly be its prior")
        elif np.ptp(lines) < _SHORT * image.lines:
            found.append(
                f"the points of image {image.name} span lines {lines.min():.0f} .. {lines.max():.0f} of {image.lines}: "
                "its orientation is extrapolated elsewhere"
            )
    return found


def _convergence(network: Network) -> Array:
    """Angle (rad) between the outermost rays of each tie point with two rays or more."""
    rays = network.rays
    origins, directions = np.empty((rays.point.size, 3)), np.empty((rays.point.size, 3))
    for j, image in enumerate(network.images):
        mine = rays.image == j
        origins[mine], directions[mine], _, _ = image.rays(*rays.places[mine].T)
    _, _, angle = intersect_rays(origins, directions, rays.point, len(network.points))
    return np.asarray(angle[(network.points.classes == PointClass.TIE) & (network.ray_counts >= 2)])
