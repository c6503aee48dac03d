"""Names and units of scalar measures, many at a time: what is a million strings is put together from few."""

import numpy as np

from mgsgraph.adjustment.graph import Layout
from mgsgraph.analysis.measures import MeasureKind, Measures, Places
from mgsgraph.geometry.orientation import COMPONENTS
from mgsgraph.geometry.records import Index

_POWERS = ("constant", "linear", "quadratic", "cubic")
_WHAT = {
    MeasureKind.RAY: ("line", "sample"),
    MeasureKind.RANGE: ("range",),
    MeasureKind.GROUND: ("a-priori x", "a-priori y", "a-priori z"),
    MeasureKind.HEIGHT: ("height above the terrain",),
}
_WIDEST = 3


def names_of(layout: Layout, measures: Measures, chosen: Index) -> list[str]:
    """What each of the chosen measures (k,) is, in words."""
    network, kind = layout.network, measures.kind[chosen]
    heads = [""] * (_WIDEST * len(MeasureKind))
    for one, parts in _WHAT.items():
        for component, part in enumerate(parts):
            heads[_WIDEST * one + component] = f"{part} of point "
    head, image = _WIDEST * kind.astype(np.int64) + measures.component[chosen], measures.image[chosen]
    priors = np.flatnonzero(kind == MeasureKind.PRIOR)
    head[priors], image[priors] = len(heads) + np.arange(priors.size), -1
    places = zip(*_variables_of(layout, measures.row[chosen[priors]]), strict=True)
    heads += [_prior_name(layout, variable, inside) for variable, inside in places]
    ids, images = network.points.ids, [*(f" in image {one.name}" for one in network.images), ""]
    rows = zip(head.tolist(), measures.point[chosen].tolist(), image.tolist(), strict=True)
    return [heads[h] + (ids[i] if i >= 0 else "") + images[j] for h, i, j in rows]


def units_of(layout: Layout, measures: Measures, chosen: Index) -> list[str]:
    """Unit of each of the chosen measures (k,): px, m, rad or s."""
    kind = measures.kind[chosen]
    units = ["px" if one else "m" for one in (kind == MeasureKind.RAY).tolist()]
    priors = np.flatnonzero(kind == MeasureKind.PRIOR)
    places = zip(*_variables_of(layout, measures.row[chosen[priors]]), strict=True)
    for k, (variable, inside) in zip(priors.tolist(), places, strict=True):
        units[k] = _prior_unit(layout, variable, inside)
    return units


def _variables_of(layout: Layout, columns: Places) -> tuple[list[int], list[int]]:
    """Variable of each of some columns (k,), and which of its columns it is."""
    adjusted = np.array(layout.variables.adjusted(), dtype=np.int64)
    first = layout.variables.first[adjusted]
    place = np.searchsorted(first, columns, side="right") - 1
    return adjusted[place].tolist(), (columns - first[place]).tolist()


def _prior_name(layout: Layout, variable: int, inside: int) -> str:
    network = layout.network
    if variable < len(network.images):
        power, component = divmod(inside, len(COMPONENTS))
        term = _POWERS[power] if power < len(_POWERS) else f"u^{power}"
        return f"a-priori {term} {COMPONENTS[component]} of image {network.images[variable].name}"
    k = variable - len(network.images)
    if k < len(network.shift_names):
        return f"a-priori {network.shift_terms[k][inside].name} of {network.shift_names[k]}"
    if variable >= network.first_of_strips[0]:
        strip, node = network.of_strips(variable)
        what, component = strip.part(node, inside)
        return f"a-priori {COMPONENTS[component]} of {what} of strip {strip.name}"
    shared = network.shared[k - len(network.shift_names)]
    return " ".join([f"a-priori {shared.name}", shared.kind.components[inside]]).strip()


def _prior_unit(layout: Layout, variable: int, inside: int) -> str:
    network = layout.network
    k = variable - network.first_shared
    if variable >= network.first_of_strips[0]:
        strip, node = network.of_strips(variable)
        return "rad" if strip.part(node, inside)[1] >= 3 else "m"
    if k >= 0:
        return network.shared[k].kind.unit
    if variable < len(network.images):
        return "rad" if inside % len(COMPONENTS) >= 3 else "m"
    return network.shift_terms[variable - len(network.images)][inside].unit
