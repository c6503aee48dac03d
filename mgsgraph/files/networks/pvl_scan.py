"""Points of a control network in PVL text straight from the file's bytes, by compiled code.

The scanner takes only what it wholly understands: statements as `networks.pvl_statements` knows them, keywords and
choices that ISIS knows (`networks.pvl_words`), each once, places that are whole. At anything else it stops; then the
file is for `files.pvl` and `networks.pvl`, which know what it means, or what is wrong with it.
"""

import numpy as np

from mgsgraph.compiled import cached_kernel, compiled
from mgsgraph.files.networks import pvl_words as words
from mgsgraph.files.networks.pvl_statements import (
    behind_blanks,
    is_null,
    keep_matrix,
    keep_number,
    keyword_at,
    meaning_of,
    next_line,
    value_at,
    word_number,
)
from mgsgraph.files.networks.wire import TEXTS, image_number, measured_twice

_FREE, _CONSTRAINED = 0, 1


@compiled
def _measure(data, at, known, k, measures, name, unused):
    """Read a measure, up to its end: where its line, sample and their sigmas are, whether it is ignored, and where its
    image's name is; the next line, or -1 for an odd one.
    """
    spans, flags, roles, columns = measures[1], measures[2], known[3], known[4]
    seen = np.uint64(0)
    spans[:, k] = 0
    flags[k] = False
    name[:] = 0
    while True:
        at = behind_blanks(data, at)
        if at < 0:
            return -1
        key, at = keyword_at(data, at, known[0])
        if key == words.END_GROUP:
            return next_line(data, at) if name[1] > name[0] else -1
        bit = np.uint64(1) << np.uint64(max(key, 0))
        if key < 0 or seen & bit or roles[1, key] == words.UNKNOWN:
            return -1
        seen |= bit
        begin, end, unit, at = value_at(data, at, known)
        if at < 0:
            return -1
        role, column, null = roles[1, key], columns[key], is_null(data, begin, end)
        if role == words.NAME:
            if null or not 0 < end - begin <= TEXTS:
                return -1
            name[0], name[1] = begin, end
        elif role == words.PIXEL:
            span = spans[column, k] if column >= 0 else unused
            if not null and not ((unit == 0 or unit == words.IN_PIXELS) and keep_number(data, begin, end, span)):
                return -1
        elif role != words.TEXT and not null:
            meaning = meaning_of(data, begin, end, role, known)
            if meaning < 0:
                return -1
            if key == words.IGNORE:
                flags[k] = meaning == 1


@compiled
def _point_value(data, key, begin, end, unit, i, known, points, here, in_km):
    """Take what stands behind a keyword of a point; whether it was understood."""
    ids, kinds, ignored = points
    role, column, null = known[3][0, key], known[4][key], is_null(data, begin, end)
    if role == words.NAME:
        ids[i, 0], ids[i, 1] = begin, end
        return not null and 0 < end - begin <= TEXTS
    if role == words.LENGTH:
        in_km[column] = unit == words.IN_KILOMETRES
        in_place = unit == 0 or unit == words.IN_METRES or unit == words.IN_KILOMETRES
        return null or (in_place and keep_number(data, begin, end, here[column]))
    if role == words.MATRIX:
        return null
    if role == words.TEXT or (null and role != words.POINT_TYPE):
        return True
    meaning = meaning_of(data, begin, end, role, known)
    if role == words.POINT_TYPE:
        kinds[i] = meaning
    elif key == words.IGNORE:
        ignored[i] = meaning == 1
    return meaning >= 0


@compiled
def _point(data, at, known, i, k, points, here, in_km, matrices, measures, table, images, spare):
    """Read a point, up to its end: the next line, or -1 for an odd one, -2 where the table of images is full; number of
    the next measure, and whether it has an a-priori covariance.
    """
    seen, given, name, unused = np.uint64(0), False, spare[0], spare[1]
    here[:] = 0
    while True:
        at = behind_blanks(data, at)
        if at < 0:
            return -1, k, False
        key, at = keyword_at(data, at, known[0])
        if key == words.END_OBJECT:
            return next_line(data, at), k, given
        if key == words.GROUP:
            begin, end, _, at = value_at(data, at, known)
            if at < 0 or word_number(data, begin, end, known[1]) != words.CONTROL_MEASURE or k >= measures[2].size:
                return -1, k, False
            at = _measure(data, at, known, k, measures, name, unused)
            if at < 0:
                return -1, k, False
            number = image_number(data, name[0], name[1], table, images)
            if number < 0:
                return -2, k, False
            measures[3][k] = number
            k += 1
            continue
        bit = np.uint64(1) << np.uint64(max(key, 0))
        if key < 0 or seen & bit or known[3][0, key] == words.UNKNOWN:
            return -1, k, False
        seen |= bit
        if known[3][0, key] == words.MATRIX:
            column = known[4][key]
            behind = keep_matrix(data, at, known, matrices[column])
            if behind >= 0:
                given |= column == 0
                at = behind
                continue
        begin, end, unit, at = value_at(data, at, known)
        if at < 0 or not _point_value(data, key, begin, end, unit, i, known, points, here, in_km):
            return -1, k, False


@compiled
def _place(i, kind, here, in_km, places, places_in_km):
    """Keep the place of a point: the a-priori one, or for a free point the adjusted one; whether each is whole."""
    for stage in (0, 3):
        there = (here[stage, 1] > 0) + (here[stage + 1, 1] > 0) + (here[stage + 2, 1] > 0)
        if there != 0 and there != 3:
            return False
    first = 3 if kind == _FREE and here[0, 1] == 0 else 0
    for c in range(3):
        places[c, i, 0], places[c, i, 1] = here[first + c, 0], here[first + c, 1]
        places_in_km[c, i] = in_km[first + c]
    return True


@cached_kernel
def read_points(data, at, known, table, images, ids, kinds, ignored, places, in_km, matrices, of_matrix, first, spans,
                flags, image):  # fmt: skip
    """Read the points of a network, up to its end; numbers of points, of measures and of covariances, and the place
    behind. -1 points where something was not understood, -2 where the table of images was full.

    Parameters
    ----------
    data : (b,) uint8
        All of the file.
    at : int
        Where the first point begins.
    known : tuple
        `pvl_words.KNOWN`.
    table : (2^q,)
        -1 everywhere.
    images : (m + 1, 2)
        Of each distinct image where its name lies, filled here; their number in the last row, 0 at the beginning.
    ids : (n, 2)
        Where each point's id lies, filled here, as all that follow.
    kinds : (n,) int64
        PointKind.
    ignored : (n,) bool
    places : (3, n, 2)
        Where the coordinates of each point lie; 0, 0 for none.
    in_km : (3, n) bool
        Those in km; others are in m.
    matrices : (6, c, 2)
        Where the a-priori covariances of constrained points lie, in m^2: xx, xy, xz, yy, yz, zz.
    of_matrix : (c,)
        Their points.
    first : (n + 1,)
        Number of each point's first measure.
    spans : (4, k, 2)
        Where line, sample and their sigmas lie, in pixels; 0, 0 for none.
    flags : (k,) bool
        Measures that are ignored.
    image : (k,)
        Number of each measure's image.
    """
    i, k, c = 0, 0, 0
    points, measures = (ids, kinds, ignored), (first, spans, flags, image)
    here, km = np.zeros((6, 2), dtype=np.int64), np.zeros(6, dtype=np.bool_)
    spare, both = np.zeros((2, 2), dtype=np.int64), np.zeros((2, 6, 2), dtype=np.int64)
    while True:
        at = behind_blanks(data, at)
        if at < 0:
            return -1, 0, 0, 0
        key, at = keyword_at(data, at, known[0])
        if key == words.END_OBJECT:
            first[i] = k
            return i, k, c, next_line(data, at)
        begin, end, _, at = value_at(data, at, known)
        if key != words.OBJECT or at < 0 or i >= kinds.size:
            return -1, 0, 0, 0
        if word_number(data, begin, end, known[1]) != words.CONTROL_POINT:
            return -1, 0, 0, 0
        first[i], kinds[i], ignored[i], ids[i, 1] = k, -1, False, 0
        at, k, given = _point(data, at, known, i, k, points, here, km, both, measures, table, images, spare)
        if at < 0 or kinds[i] < 0 or ids[i, 1] == 0 or not _place(i, kinds[i], here, km, places, in_km):
            return min(at, -1), 0, 0, 0
        if not ignored[i] and measured_twice(first[i], k, flags, image):
            return -1, 0, 0, 0
        if given and kinds[i] == _CONSTRAINED and c < of_matrix.size:
            matrices[:, c], of_matrix[c] = both[0], i
            c += 1
        i += 1
