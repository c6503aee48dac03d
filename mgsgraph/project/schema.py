"""Tables of a project's SQLite file.

SQLite keeps the comments: `sqlite3 project.sqlite .schema` explains the file. SI units, body-fixed metres, times in
seconds TDB past J2000. The user version is a checksum (`checksum.py`): whoever changes the file otherwise damages it.
Numbers stand in columns without a type: one of type REAL loses the sign of zero. NaN is NULL.
Blobs named so hold float64, little-endian, row by row; the others are NumPy archives (.npz).

Points, rays, ranges and stereo heights, of which there are millions, stand in packed columns (`columns.py`): a row of
their tables holds those of one bundle, a cell one column of them. A cell with one number alone means that number for
all; NULL means zeros.
"""

FORMAT = 8
"""Number of the layout; raised with every change of a table."""
APPLICATION = 0x4D475347
"""SQLite's application id ("MGSG"): by it the file is known as ours."""

TABLES = (
    """CREATE TABLE meta ( -- what this file is
    key TEXT PRIMARY KEY, -- format, name, created (UTC), version (of mgsgraph), settings (JSON), case (path),
    -- networks (JSON: paths of files of tie points)
    value TEXT NOT NULL
) WITHOUT ROWID""",
    """CREATE TABLE image (
    id INTEGER PRIMARY KEY AUTOINCREMENT, -- grows in the order in which images came
    name TEXT NOT NULL UNIQUE,
    held INTEGER NOT NULL, -- 1: its orientation is not adjusted
    record BLOB NOT NULL, -- .npz: camera, timing, trajectory, a-priori sigmas of the orientation
    picture TEXT -- file of its pixels, where known
)""",
    """CREATE TABLE source ( -- files that an image was read from
    image INTEGER NOT NULL REFERENCES image,
    path TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    PRIMARY KEY (image, path)
) WITHOUT ROWID""",
    """CREATE TABLE shared ( -- adjusted unknowns that points share
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    kind TEXT NOT NULL, -- image: orientation coefficients; shift: of a laser profile or of the terrain model;
    -- shared: of several images; node, trend: orientation image of a pass (position, rotation), its bias and drift
    name TEXT NOT NULL,
    prior BLOB NOT NULL, -- float64 (d), m and rad, a-priori sigmas
    motion BLOB NOT NULL, -- float64 (d), pixels by which image places move, per m and per rad
    ground BLOB NOT NULL, -- float64 (3, d), m by which the ground under the image's middle moves, per m and per rad
    value BLOB NOT NULL, -- float64 (d), m and rad, adjusted
    covariance BLOB NOT NULL, -- float64 (d, d), for sigma0 = 1
    considered INTEGER NOT NULL DEFAULT 0, -- 1: held at zero, while its a-priori covariance is carried
    UNIQUE (kind, name)
)""",
    """CREATE TABLE terrain ( -- grids of the terrain model and of the areoid
    id INTEGER PRIMARY KEY,
    sha256 TEXT NOT NULL UNIQUE, -- of the record
    source TEXT NOT NULL,
    record BLOB NOT NULL -- .npz: posts, m
)""",
    """CREATE TABLE profile ( -- laser profiles with an unknown horizontal shift
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    sigma NOT NULL, -- m, a-priori, east and north
    considered INTEGER NOT NULL DEFAULT 0 -- 1: not estimated
)""",
    """CREATE TABLE bundle ( -- all points that feel the same shared unknowns
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    members TEXT NOT NULL UNIQUE, -- JSON: [kind, name] of these unknowns, in order
    points INTEGER NOT NULL, -- how many
    rays INTEGER NOT NULL,
    ranges INTEGER NOT NULL,
    terrain INTEGER REFERENCES terrain, -- model that its points lie on
    terrain_shift_sigma, -- m, a-priori, of that model
    terrain_considered INTEGER NOT NULL DEFAULT 0, -- 1: that shift is not estimated
    areoid INTEGER REFERENCES terrain,
    unknowns TEXT, -- JSON: those of the reduced system, in the order of its columns; NULL where there is none
    at BLOB, -- float64 (d), m and rad, where the reduced system was made
    normal BLOB, -- float64 (d, d), per m and rad
    gradient BLOB, -- float64 (d)
    cost, -- half the weighted sum of squares of the points' rows there
    slack -- pixels by which image places may move before it has to be made anew
)""",
    """CREATE TABLE bundle_image ( -- images with a ray or a range in a bundle
    image INTEGER NOT NULL REFERENCES image,
    bundle INTEGER NOT NULL REFERENCES bundle,
    position INTEGER NOT NULL, -- of the image in the bundle's network
    PRIMARY KEY (image, bundle)
) WITHOUT ROWID""",
    "CREATE INDEX image_of_bundle ON bundle_image (bundle, position)",
    """CREATE TABLE stereo_surface ( -- surfaces that two images show, averaged over a footprint
    id INTEGER PRIMARY KEY,
    sha256 TEXT NOT NULL UNIQUE, -- of the record and the images
    first INTEGER NOT NULL REFERENCES image,
    second INTEGER NOT NULL REFERENCES image,
    record BLOB NOT NULL -- .npz: places in the second image of nodes in the first
)""",
    """CREATE TABLE point_names ( -- names of the points of a bundle
    bundle INTEGER PRIMARY KEY REFERENCES bundle,
    size INTEGER NOT NULL, -- how many
    text BLOB NOT NULL, -- UTF-8, one after another
    ends BLOB NOT NULL -- int32 (n), byte of the text where each ends
)""",
    """CREATE TABLE point_columns ( -- points of a bundle, packed
    bundle INTEGER PRIMARY KEY REFERENCES bundle,
    size INTEGER NOT NULL, -- how many
    class BLOB, -- int8 (n), 0 tie, 1 laser, 2 control
    kind BLOB, -- int8 (n), 0 free, 1 constrained, 2 fixed
    profile BLOB, -- int32 (n), laser profile whose shift it shares; 0 for none
    surface_sigma BLOB, -- float64 (n), m, of its height above the terrain model; Inf for none
    place BLOB, -- float64 (n, 3), m, body-fixed, a-priori; NaN where unknown
    covariance BLOB -- float64 (n, 3, 3), m^2, a-priori
)""",
    """CREATE TABLE adjusted_columns ( -- where they are after the adjustment
    bundle INTEGER PRIMARY KEY REFERENCES bundle,
    size INTEGER NOT NULL,
    place BLOB, -- float64 (n, 3), m, body-fixed; NaN where undetermined or not adjusted yet
    covariance BLOB -- float64 (n, 3, 3), m^2, for sigma0 = 1; NaN where the place is
)""",
    """CREATE TABLE ray_columns ( -- image coordinates of them, packed
    bundle INTEGER PRIMARY KEY REFERENCES bundle,
    size INTEGER NOT NULL, -- how many
    point BLOB, -- int32 (k), of the bundle, from 0 on
    image BLOB, -- int32 (k), position in the bundle (bundle_image)
    place BLOB, -- float64 (k, 2), line and sample in pixels, the first pixel's centre at (0.5, 0.5)
    sigma BLOB, -- float64 (k, 2), pixels
    back_projected BLOB, -- int8 (k), 1: a projection with the nominal orientation
    rejected BLOB -- int8 (k), 1: a blunder to the last batch adjustment
)""",
    """CREATE TABLE range_columns ( -- laser ranges to them, packed
    bundle INTEGER PRIMARY KEY REFERENCES bundle,
    size INTEGER NOT NULL, -- how many
    point BLOB, -- int32 (r), of the bundle, from 0 on
    image BLOB, -- int32 (r), position in the bundle of the image whose orientation carries it
    time BLOB, -- float64 (r), s TDB past J2000
    value BLOB, -- float64 (r), m, one-way
    sigma BLOB, -- float64 (r), m
    rejected BLOB -- int8 (r), 1: a blunder to the last batch adjustment
)""",
    """CREATE TABLE height_columns ( -- heights of them above stereo surfaces, packed
    bundle INTEGER PRIMARY KEY REFERENCES bundle,
    size INTEGER NOT NULL, -- how many
    point BLOB, -- int32 (h), of the bundle, from 0 on
    surface BLOB, -- int32 (h), number of the stereo surface
    sigma BLOB, -- float64 (h), m, of the height above it
    rejected BLOB, -- int8 (h), 1: a blunder to the last batch adjustment
    level BLOB -- int8 (h), 1: as if the ground were level, for its horizontal position isn't found
)""",
    """CREATE TABLE bundle_surface ( -- stereo surfaces that points of a bundle lie on
    bundle INTEGER NOT NULL REFERENCES bundle,
    surface INTEGER NOT NULL REFERENCES stereo_surface,
    PRIMARY KEY (bundle, surface)
) WITHOUT ROWID""",
    """CREATE TABLE change ( -- history
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL, -- UTC
    verb TEXT NOT NULL, -- init, match, add, remove, solve, check, coregister, edit
    what TEXT NOT NULL,
    summary TEXT NOT NULL -- JSON
)""",
    """CREATE TABLE solution (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    change INTEGER NOT NULL, -- the last one that it knows of
    at TEXT NOT NULL, -- UTC
    converged INTEGER NOT NULL,
    message TEXT NOT NULL,
    cost, -- half the weighted sum of squares
    sigma0,
    degrees_of_freedom INTEGER,
    images INTEGER NOT NULL, points INTEGER NOT NULL, -- how many
    folder TEXT, -- of its products, in the project's folder
    kind TEXT NOT NULL DEFAULT 'batch' -- batch or incremental
)""",
    """CREATE TABLE pass ( -- images on one trajectory
    name TEXT PRIMARY KEY,
    record BLOB NOT NULL -- .npz: names of images, times of the orientation images, prior, how cameras are mounted
) WITHOUT ROWID""",
    """CREATE TABLE shared_by_images ( -- unknowns that several images share
    name TEXT PRIMARY KEY,
    record BLOB NOT NULL -- .npz: kind, names of images, a-priori sigmas
) WITHOUT ROWID""",
    """CREATE TABLE edit ( -- measures and a-priori places that a person has changed, one point each
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    change INTEGER NOT NULL REFERENCES change,
    kind TEXT NOT NULL, -- measure, move, reject, accept, hold, release, remove, undo
    point TEXT NOT NULL,
    before TEXT, -- JSON: kind, a-priori place, measures; NULL where there was no such point
    after TEXT, -- the same afterwards
    undoes INTEGER REFERENCES edit -- of kind undo
)""",
    "CREATE INDEX edit_of_point ON edit (point, number)",
)
"""Statements that make an empty project."""
