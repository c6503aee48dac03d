"""Incremental adjustment: images come and go, iSAM2 holds the shared unknowns, points stay in their bundles."""

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mgsgraph.adjustment.incremental.engine import Engine
from mgsgraph.adjustment.incremental.impact import Closing, Impact, closing, impact
from mgsgraph.adjustment.incremental.state import (
    ImagesByName,
    InMemory,
    Settled,
    Shared,
    StateStore,
    image_motion,
    require_one_body,
    shared_by_images,
    shared_image,
    shared_of,
    shared_pass,
    shared_shift,
    with_addition,
    with_points,
    without,
)
from mgsgraph.adjustment.incremental.sweep import Sweep
from mgsgraph.adjustment.incremental.trajectories import extended, shortened, turned_bundles, unknowns_of
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import TiePoints
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.names import number_of
from mgsgraph.network import Network
from mgsgraph.network.corrections import whole_correction
from mgsgraph.network.joining import Definitions, definitions, with_definitions
from mgsgraph.network.observations import build_network
from mgsgraph.network.parts import (
    KnownImage,
    Members,
    Unknown,
    alone,
    known_images,
    require_separable,
    unknowns,
    with_images,
)
from mgsgraph.record import Record, card
from mgsgraph.units import ARCSEC
from mgsgraph.workers import no_progress

if TYPE_CHECKING:
    from mgsgraph.adjustment.rounds import Progress
    from mgsgraph.adjustment.solution import Solution

Observations = TiePoints | LaserProfile | Sequence[TiePoints | LaserProfile]


class IncrementalAdjustment(Record):
    """Images and their observations, adjusted as they come.

    Parameters
    ----------
    settings : SolverSettings, optional
        Measurement model and loss; the defaults when absent. Blunders are sought by batch alone (`close`).
    store : StateStore, optional
        Where the state lies; in memory when absent.

    Examples
    --------
    >>> adjustment = mgsgraph.IncrementalAdjustment.of(solution)
    >>> impact = adjustment.remove("SIM/B")
    >>> adjustment.images, adjustment.covariance("SIM/A").shape
    (['SIM/A'], (18, 18))
    """

    def __init__(self, settings: SolverSettings | None = None, store: StateStore | None = None) -> None:
        self.settings = settings or SolverSettings()
        self.store: StateStore = InMemory() if store is None else store
        self._engine = Engine(self.settings, self.store)

    @classmethod
    def of(cls, solution: "Solution", store: StateStore | None = None) -> "IncrementalAdjustment":
        """An incremental adjustment that begins with a batch solution."""
        found = cls(solution.settings, store)
        found.adopt(solution)
        return found

    def __repr__(self) -> str:
        return f"IncrementalAdjustment({len(self.images)} images, {len(self.store.members())} bundles of points)"

    def _repr_html_(self) -> str:
        """For notebooks: each image with the sigmas of its constant term."""
        rows = [("image", "position", "pointing"), ("", "m", "arcsec")]
        for name in self.images:
            if (one := self._engine.shared.get(Unknown("image", name))) is None:
                rows.append((name, "held", "held"))
                continue
            position, pointing = (float(np.linalg.norm(part)) for part in np.split(one.sigmas[:6], 2))
            rows.append((name, f"{position:.3g}", f"{pointing / ARCSEC:.3g}"))
        return card(repr(self), ["Sigmas of the images' position and pointing, as they were last looked at."], rows, 2)

    # --- what may be asked

    @property
    def images(self) -> list[str]:
        """Names of all images, in the order in which they came."""
        return self.store.image_names()

    @property
    def values(self) -> Mapping[Unknown, Array]:
        """Present values (d,) of all shared unknowns, m and rad."""
        return dict(self._engine.value)

    def correction(self, image: str | int) -> OrientationCorrection:
        """Present orientation correction of an image, with what shared unknowns do to it; zero for a held one."""
        known = self._known(image)
        one = with_definitions(alone(known), self._engine.known)
        own, value = Unknown("image", known.image.name), self._engine.value
        zero = np.zeros(one.priors[0].sigmas.size)
        values = [value.get(name, zero) if name != own or not one.held[0] else zero for name in unknowns(one)]
        return whole_correction(one, 0, values, self.settings.angles)

    def covariance(self, *images: str | int) -> Array:
        """Joint covariance (d, d) of the coefficients of some images, m and rad, straight from iSAM2."""
        names = [self._known(image).image.name for image in images]
        for image in names:
            if self._known(image).held:
                raise InputError(f"image {image}", "held: it has no unknowns", "an adjusted image")
            if (one := self._engine.known.of_image(image)) is not None:
                found, remedy = f"of pass {one.name!r}: it has no coefficients of its own", "ask for `joint`"
                raise InputError(f"image {image}", found, "an image with an orientation of its own", remedy)
        return self._engine.joint([Unknown("image", image) for image in names])

    def joint(self, wanted: Sequence[Unknown]) -> Array:
        """Joint covariance (d, d) of some adjusted unknowns, m and rad, straight from iSAM2."""
        return self._engine.joint(wanted)

    def points(self, ids: Sequence[str] | None = None) -> tuple[tuple[str, ...], Array, Array]:
        """Names, places (n, 3) in m and covariances (n, 3, 3) in m^2 of points, refreshed; all of them when absent.

        Undetermined points have NaN. Raises InputError for an unknown name.
        """
        wanted = set(self.store.members()) if ids is None else set(self.store.bundles_of(ids).values())
        fresh = list(self._engine.refreshed(sorted(wanted)).values())
        names = tuple(name for one in fresh for name in one.network.points.ids)
        places = np.concatenate([np.zeros((0, 3)), *(one.places for one in fresh)])
        covariances = np.concatenate([np.zeros((0, 3, 3)), *(one.covariances for one in fresh)])
        if ids is None:
            return names, places, covariances
        where = {name: k for k, name in enumerate(names)}
        for name in ids:
            if name not in where:
                raise InputError(f"point {name}", "no such point", "one of the adjustment's")
        chosen = [where[name] for name in ids]
        return tuple(ids), places[chosen], covariances[chosen]

    @property
    def network(self) -> Network:
        """Everything as one network, images in the order in which they came."""
        return self._as_network()[0]

    def as_network(self) -> tuple[Network, Array]:
        """Everything as one network, and the places (n, 3) in m of its points, refreshed; NaN where undetermined."""
        network, stored = self._as_network()
        return network, Sweep(network, self.settings, stored).places(self._engine.value)

    def _as_network(self) -> tuple[Network, Array]:
        """All of it as one network, and the places (n, 3) in m of its points as they are in store."""
        if not self.store.members():
            raise InputError("incremental adjustment", "no points", "observations in at least one image")
        return self.store.as_network()

    # --- what may be done

    def add(
        self,
        images: Network | PushbroomImage | KnownImage | Sequence[KnownImage],
        observations: Observations = (),
        prior: OrientationPrior | None = None,
        tie_sigma: float = 1.0,
        shot_sigma: float = 30.0,
        brought: Definitions | None = None,
    ) -> Impact:
        """Add images with what is observed in them (and, of points that were there before, in others).

        Parameters
        ----------
        images : Network, PushbroomImage, KnownImage, or several of the latter
            A network brings its observations with it; those of its images that are known already are not new.
        observations : TiePoints, LaserProfile, or several
            Points known already come again by their ids, with their new measures.
        prior : OrientationPrior, optional
            Of a PushbroomImage; that of the image added last when absent.
        tie_sigma, shot_sigma : float
            px, of the image coordinates of tie points for which their file says nothing, and of laser footprints.
        brought : Definitions, optional
            Passes and shared unknowns that new images join or begin; those of the network when absent. The trajectory
            of a pass that is there is continued over the lines of its new images, on its own grid.

        Raises
        ------
        InputError
            When an image is there already, a measure names an unknown image or is there already, or parts contradict.
        PointBehindCamera
            With the nominal orientation of a new image. In all cases nothing has changed then.
        """
        if isinstance(images, Network):
            require_separable(images)
            there = set(self.images)
            named = ((one.image.name, one) for one in known_images(images))
            known = [self.store.image(name) if name in there else one for name, one in named]
            more = [one for one in known if one.image.name not in there]
            # of images that are there, a network doesn't say anew what is known of them
            brought = definitions(images) if brought is None else brought
            return self._added(more, with_images(with_definitions(images, Definitions()), known), brought)
        new = self._new_images(images, prior)
        every = [observations] if isinstance(observations, TiePoints | LaserProfile) else list(observations)
        addition = build_network(ImagesByName(self.store, new), every, tie_sigma, shot_sigma)
        return self._added(new, addition, brought)

    def remove(self, *images: str | int) -> Impact:
        """Take images out with their measures; points that nothing else sees go, too.

        Raises InputError for an unknown image.
        """
        names = tuple(dict.fromkeys(self._known(image).image.name for image in images))
        before = self.store.definitions()
        after = shortened(self.store, before, names)
        changed = without(self.store, names, after, turned_bundles(self.store, before, after))
        return self._change("remove", list(names), [], *changed, after)

    def resume(self, store: StateStore) -> None:
        """Go on with a store that holds the same state, opened anew."""
        self.store = store
        self._engine.resume(store)

    def put_points(self, ids: Sequence[str], network: Network | None, verb: str = "edit") -> Impact:
        """Put points as a network has them, with all of their rows, in the place of what they were before.

        Parameters
        ----------
        ids : sequence of str
            Names of these points.
        network : Network or None
            With images that are there; None takes the points out.
        verb : str
            What is said to have been done.

        Raises
        ------
        InputError
            When parts contradict each other; nothing has changed then.
        """
        known = self.store.definitions()
        return self._change(verb, (), (), *with_points(self.store, ids, network, known), known)

    def close(self, name: str = "adjustment", progress: "Progress" = no_progress) -> tuple[Closing, "Solution"]:
        """The closing check: batch over everything, from the nominal orientation, and how far the two lie apart.

        Where anything is farther off than `EXACT` sigmas, what batch has found takes the place of what was there.
        """
        from mgsgraph.adjustment.adjust import adjust_network  # a whole batch solver, which changes do without

        network, places = self.as_network()
        solution = adjust_network(network, replace(self.settings, starts=0), name, progress)
        found = closing(solution, self._engine.value, places)
        if found.adopted:
            self.adopt(solution)
        return found, solution

    def adopt(self, solution: "Solution") -> None:
        """Take a batch solution over: its images, points and unknowns in the place of all that was there."""
        engine = self._engine
        rejected = solution.rays_rejected, solution.ranges_rejected, solution.stereo_rejected
        network = solution.network.with_rejected(*rejected)
        there = set(self.images)
        with engine.all_or_nothing():
            for one, own in zip(known_images(network), network.with_polynomial.tolist(), strict=True):
                if own:
                    _require_finite_prior(one)
            kept = engine.adopted(shared_of(solution), solution, network)
            for one in known_images(network):
                if one.image.name not in there or not _same_image(one, self.store.image(one.image.name)):
                    self.store.put_image(one)
            self.store.replace(self.store.members(), kept)
            for name in there - {image.name for image in network.images}:
                self.store.drop_image(name)
            self.store.put_definitions(engine.known)
            self.store.drop_shared(set(self.store.shared()) - set(engine.shared))
            self.store.put_shared(engine.shared)

    # --- how

    def _added(
        self, new: Sequence[KnownImage], addition: Network | None, brought: Definitions | None = None
    ) -> Impact:
        before = self.store.definitions()
        after = extended(self.store, before, brought or Definitions(), new)
        changed = with_addition(self.store, addition, after, turned_bundles(self.store, before, after))
        return self._change("add", [one.image.name for one in new], new, *changed, after)

    def _known(self, image: str | int) -> KnownImage:
        names = self.images
        return self.store.image(names[number_of(image, {name: j for j, name in enumerate(names)}, "image")])

    def _new_images(
        self, images: PushbroomImage | KnownImage | Sequence[KnownImage], prior: OrientationPrior | None
    ) -> list[KnownImage]:
        if isinstance(images, PushbroomImage):
            if prior is None and not self.images:
                raise InputError(f"image {images.name}", "no a-priori sigmas", "a prior for the first image")
            images = KnownImage(images, prior or self.store.image(self.images[-1]).prior)
        new, there = [images] if isinstance(images, KnownImage) else list(images), set(self.images)
        for name, count in Counter(one.image.name for one in new).items():
            if name in there or count > 1:
                found = "in the adjustment already" if name in there else "named twice"
                raise InputError(f"image {name}", found, "an image that is new", "remove it first to replace it")
        return new

    def _new_unknowns(
        self, new: Sequence[KnownImage], networks: Mapping[Members, Network], known: Definitions
    ) -> dict[Unknown, Shared]:
        """Orientation of new images, shifts that come with an addition, orientation images of passes that are new or go
        on, and new unknowns that images share; at zero.
        """
        found, angles = dict[Unknown, Shared](), self.settings.angles
        every = ImagesByName(self.store, new)
        for of_pass in known.passes.values():
            if of_pass is not self._engine.known.passes.get(of_pass.name):
                found |= shared_pass(of_pass, every, angles)
        for name, by_images in known.shared.items():
            found[Unknown("shared", name)] = shared_by_images(by_images, every, angles)
        found = {unknown: start for unknown, start in found.items() if unknown not in self._engine.shared}
        for one in new:
            if known.of_image(one.image.name) is not None:
                continue
            _require_finite_prior(one)
            if not one.held:
                unknown = Unknown("image", one.image.name)
                found[unknown] = shared_image(one, self.settings.angles)
        for members, network in networks.items():
            for unknown in members:
                if unknown.kind == "shift" and unknown not in self._engine.shared:
                    motion = max(image_motion(one)[0] for one in known_images(network))
                    found[unknown] = shared_shift(network, unknown.name, motion)
        return found

    def _change(
        self,
        verb: str,
        subjects: Sequence[str],
        new: Sequence[KnownImage],
        gone: Sequence[Members],
        networks: Mapping[Members, Network],
        known: Definitions,
    ) -> Impact:
        """Put bundles in the place of others, keep what has come of it, and say what has happened; `known` are the
        passes and shared unknowns from now on.
        """
        began, engine, removing = time.perf_counter(), self._engine, verb == "remove"
        require_one_body(self.store, new)
        before = dict(engine.shared)
        old = {members: self.store.bundle(members) for members in gone}
        with engine.all_or_nothing():
            dropped = [u for name in subjects if removing and (u := Unknown("image", name)) in before]
            dropped += [unknown for unknown in unknowns_of(engine.known) if unknown not in set(unknowns_of(known))]
            settled = engine.replaced(gone, networks, self._new_unknowns(new, networks, known), dropped, known)
            old |= {members: self.store.bundle(members) for members in settled.bundles if members not in networks}
            report = impact(verb, subjects, settled, old, before, engine.shared)
            self.store.put_definitions(known)
            self._keep(settled, gone, networks, new, before)
            for name in subjects if removing else ():
                self.store.drop_image(name)
        return report.after(time.perf_counter() - began)

    def _keep(
        self,
        settled: Settled,
        gone: Sequence[Members],
        networks: Iterable[Members],
        new: Sequence[KnownImage],
        before: Mapping[Unknown, Shared],
    ) -> None:
        """Write the new state to the store."""
        shared = self._engine.shared
        for one in new:
            self.store.put_image(one)
        there = {members: one for members, one in settled.bundles.items() if members not in networks}
        self.store.replace(gone, {members: settled.bundles[members] for members in networks})
        self.store.renew(there)
        self.store.put_shared({unknown: one for unknown, one in shared.items() if one is not before.get(unknown)})
        self.store.drop_shared([unknown for unknown in before if unknown not in shared])


def _same_image(one: KnownImage, other: KnownImage) -> bool:
    return one.image is other.image and one.prior is other.prior and one.held == other.held


def _require_finite_prior(one: KnownImage) -> None:
    """Raise InputError unless every coefficient has an a-priori sigma."""
    if not np.all(np.isfinite(one.prior.sigmas)):
        found, expected = "a coefficient without an a-priori sigma", "finite sigmas, which iSAM2 needs to begin with"
        raise InputError(f"image {one.image.name}", found, expected)
