"""Tables of a project's SQLite file, and how the tables of older formats become those of this one.

SQLite keeps the comments: `sqlite3 project.sqlite .schema` explains the file. SI units, body-fixed metres, times in
seconds TDB past J2000. The user version is a checksum (`checksum.py`): whoever changes the file otherwise damages it.
Numbers stand in columns without a type: one of type REAL loses the sign of zero. NaN is NULL.
Blobs named so hold float64, little-endian, row by row; the others are NumPy archives (.npz).

The points, rays and ranges of a bundle are written together, one after the other: their numbers are a run without gaps,
by which they are read and removed, so that only names need an index.
"""

FORMAT = 6
"""Number of the layout; raised with every change of a table, together with a step in MIGRATIONS."""
APPLICATION = 0x4D475347
"""SQLite's application id ("MGSG"): by it the file is known as ours."""

_STEREO = (
    """CREATE TABLE stereo_surface ( -- surfaces that two images show, averaged over a footprint
    id INTEGER PRIMARY KEY,
    sha256 TEXT NOT NULL UNIQUE, -- of the record and the images
    first INTEGER NOT NULL REFERENCES image,
    second INTEGER NOT NULL REFERENCES image,
    record BLOB NOT NULL -- .npz: places in the second image of nodes in the first
)""",
    """CREATE TABLE stereo_height ( -- points that lie on them
    point INTEGER PRIMARY KEY REFERENCES point,
    surface INTEGER NOT NULL REFERENCES stereo_surface,
    sigma NOT NULL, -- m, of the height above it
    rejected INTEGER NOT NULL DEFAULT 0, -- 1: a blunder to the last batch adjustment
    level INTEGER NOT NULL DEFAULT 0 -- 1: as if the ground were level, for its horizontal position isn't found
)""",
)
_COMMON = (
    """CREATE TABLE pass ( -- images on one trajectory
    name TEXT PRIMARY KEY,
    record BLOB NOT NULL -- .npz: names of images, times of the orientation images, prior, how cameras are mounted
) WITHOUT ROWID""",
    """CREATE TABLE shared_by_images ( -- unknowns that several images share
    name TEXT PRIMARY KEY,
    record BLOB NOT NULL -- .npz: kind, names of images, a-priori sigmas
) WITHOUT ROWID""",
)
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
    first_point INTEGER NOT NULL, points INTEGER NOT NULL, -- number of the first, and how many
    first_ray INTEGER NOT NULL, rays INTEGER NOT NULL,
    first_range INTEGER NOT NULL, ranges INTEGER NOT NULL,
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
    """CREATE TABLE point (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    bundle INTEGER NOT NULL REFERENCES bundle,
    class INTEGER NOT NULL, -- 0 tie, 1 laser, 2 control
    kind INTEGER NOT NULL, -- 0 free, 1 constrained, 2 fixed
    x, y, z, -- m, body-fixed, a-priori; NULL where unknown
    covariance BLOB, -- float64 (3, 3), m^2, a-priori; NULL for zero
    profile INTEGER REFERENCES profile, -- laser profile whose shift it shares
    surface_sigma, -- m, of its height above the terrain model; Inf for none
    adjusted_x, adjusted_y, adjusted_z, -- m; NULL where undetermined or not adjusted yet
    sigma_x, sigma_y, sigma_z, -- m, of the adjusted place, for sigma0 = 1
    adjusted_covariance BLOB -- float64 (3, 3), m^2, for sigma0 = 1; NULL where the place is
)""",
    """CREATE TABLE ray ( -- image coordinates
    id INTEGER PRIMARY KEY,
    point INTEGER NOT NULL REFERENCES point,
    image INTEGER NOT NULL REFERENCES image,
    line NOT NULL, sample NOT NULL, -- pixels, the first pixel's centre at (0.5, 0.5)
    sigma_line NOT NULL, sigma_sample NOT NULL, -- pixels
    back_projected INTEGER NOT NULL, -- 1: a projection with the nominal orientation
    rejected INTEGER NOT NULL DEFAULT 0 -- 1: a blunder to the last batch adjustment
)""",
    """CREATE TABLE range ( -- laser ranges
    id INTEGER PRIMARY KEY,
    point INTEGER NOT NULL REFERENCES point,
    image INTEGER NOT NULL REFERENCES image, -- whose orientation carries it
    time NOT NULL, -- s TDB past J2000
    value NOT NULL, -- m, one-way
    sigma NOT NULL, -- m
    rejected INTEGER NOT NULL DEFAULT 0 -- 1: a blunder to the last batch adjustment
)""",
    *_STEREO,
    """CREATE TABLE change ( -- history
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL, -- UTC
    verb TEXT NOT NULL, -- init, match, add, remove, solve, check, coregister
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
    *_COMMON,
    """CREATE VIEW measures AS -- for reading: rays with the names of their points and images
    SELECT point.name AS point, image.name AS image, line, sample, sigma_line, sigma_sample, back_projected
    FROM ray JOIN point ON point.id = ray.point JOIN image ON image.id = ray.image""",
)
"""Statements that make an empty project."""

MIGRATIONS: dict[int, tuple[str, ...]] = {
    1: (
        "ALTER TABLE solution ADD COLUMN kind TEXT NOT NULL DEFAULT 'batch'",  # a solution was always a batch
        "ALTER TABLE ray ADD COLUMN rejected INTEGER NOT NULL DEFAULT 0",  # nothing was rejected
        "ALTER TABLE range ADD COLUMN rejected INTEGER NOT NULL DEFAULT 0",
    ),
    2: _STEREO,  # nothing lay on a stereo surface
    3: (  # every unknown was estimated
        "ALTER TABLE shared ADD COLUMN considered INTEGER NOT NULL DEFAULT 0",
        "ALTER TABLE profile ADD COLUMN considered INTEGER NOT NULL DEFAULT 0",
        "ALTER TABLE bundle ADD COLUMN terrain_considered INTEGER NOT NULL DEFAULT 0",
    ),
    4: (),  # had no checksum, which every change writes
    5: _COMMON,  # every image had an orientation of its own, and nothing was shared
}
"""Statements by which a format becomes the next one."""
