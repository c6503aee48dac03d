CREATE TABLE meta ( -- what this file is
    key TEXT PRIMARY KEY, -- format, name, created (UTC), version (of mgsgraph), settings (JSON), case (path),
    -- networks (JSON: paths of files of tie points)
    value TEXT NOT NULL
) WITHOUT ROWID;

CREATE TABLE image (
    id INTEGER PRIMARY KEY AUTOINCREMENT, -- grows in the order in which images came
    name TEXT NOT NULL UNIQUE,
    held INTEGER NOT NULL, -- 1: its orientation is not adjusted
    record BLOB NOT NULL, -- .npz: camera, timing, trajectory, a-priori sigmas of the orientation
    picture TEXT -- file of its pixels, where known
);

CREATE TABLE shared ( -- adjusted unknowns that points share
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
);

CREATE TABLE grid ( -- grids of the terrain model and of the areoid, and stereo surfaces
    id INTEGER PRIMARY KEY,
    sha256 TEXT NOT NULL UNIQUE, -- of the record and the images
    first INTEGER REFERENCES image, -- of the two images that show a stereo surface; NULL for others
    second INTEGER REFERENCES image,
    record BLOB NOT NULL -- .npz: posts, m; places in the second image of nodes in the first, averaged over a footprint
);

CREATE TABLE profile ( -- laser profiles with an unknown horizontal shift
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    sigma NOT NULL, -- m, a-priori, east and north
    considered INTEGER NOT NULL DEFAULT 0 -- 1: not estimated
);

CREATE TABLE bundle ( -- all points that feel the same shared unknowns
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    members TEXT NOT NULL UNIQUE, -- JSON: [kind, name] of these unknowns, in order
    points INTEGER NOT NULL, -- how many
    rays INTEGER NOT NULL,
    ranges INTEGER NOT NULL,
    terrain INTEGER REFERENCES grid, -- model that its points lie on
    terrain_shift_sigma, -- m, a-priori, of that model
    terrain_considered INTEGER NOT NULL DEFAULT 0, -- 1: that shift is not estimated
    areoid INTEGER REFERENCES grid,
    unknowns TEXT, -- JSON: those of the reduced system, in the order of its columns; NULL where there is none
    at BLOB, -- float64 (d), m and rad, where the reduced system was made
    normal BLOB, -- float64 (d, d), per m and rad
    gradient BLOB, -- float64 (d)
    cost, -- half the weighted sum of squares of the points' rows there
    slack -- pixels by which image places may move before it has to be made anew
);

CREATE TABLE bundle_image ( -- images with a ray or a range in a bundle
    image INTEGER NOT NULL REFERENCES image,
    bundle INTEGER NOT NULL REFERENCES bundle,
    position INTEGER NOT NULL, -- of the image in the bundle's network
    PRIMARY KEY (image, bundle)
) WITHOUT ROWID;

CREATE INDEX image_of_bundle ON bundle_image (bundle, position);

CREATE TABLE packed ( -- a column of a bundle's rows of a kind in each row, little-endian
    -- names: text UTF-8, one after another; ends int32 (n), byte of the text where each ends
    -- points: class int8 (n), 0 tie, 1 laser, 2 control; kind int8 (n), 0 free, 1 constrained, 2 fixed;
    --   profile int32 (n), laser profile whose shift it shares, 0 for none; surface_sigma float64 (n), m, of its height
    --   above the terrain model, Inf for none; place float64 (n, 3), m, body-fixed, a-priori, NaN where unknown;
    --   covariance float64 (n, 3, 3), m^2
    -- adjusted: place and covariance (for sigma0 = 1) after the adjustment; NaN where undetermined or not adjusted yet
    -- rays: point int32 (k), of the bundle, from 0 on; image int32 (k), position in the bundle (bundle_image);
    --   place float64 (k, 2), line and sample in pixels, the first pixel's centre at (0.5, 0.5); sigma (k, 2), pixels;
    --   back_projected int8 (k), 1: a projection with the nominal orientation
    -- ranges: point, image (whose orientation carries it); time float64 (r), s TDB past J2000; value, sigma, m, one-way
    -- heights: point; surface int32 (h), number in grid; sigma float64 (h), m, of the height above it;
    --   level int8 (h), 1: as if the ground were level, for its horizontal position isn't found
    -- rejected int8, of all three, 1: a blunder to the last batch adjustment
    bundle INTEGER NOT NULL REFERENCES bundle,
    kind TEXT NOT NULL, -- names, points, adjusted, rays, ranges, heights
    name TEXT NOT NULL, -- of the column; one that is not there is zeros
    size INTEGER NOT NULL, -- how many rows
    cell BLOB NOT NULL, -- numbers of all rows, or one number that all have
    PRIMARY KEY (bundle, kind, name)
);

CREATE TABLE change ( -- history
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL, -- UTC
    verb TEXT NOT NULL, -- init, match, add, remove, edit, align, undo, redo, solve, check
    what TEXT NOT NULL,
    summary TEXT NOT NULL, -- JSON
    who TEXT NOT NULL, -- account of the user
    why TEXT NOT NULL, -- reason that the user gave; empty for none
    stands INTEGER NOT NULL DEFAULT 1, -- 0: undone
    undoes INTEGER REFERENCES change, -- of undo and redo: the change that no longer stands, or stands again
    former BLOB -- .npz: the content that the change replaced (`project.history`); NULL where it replaced none
);

CREATE TABLE solution (
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
);

CREATE TABLE common ( -- what several images have in common
    kind TEXT NOT NULL, -- passes: they are on one trajectory; shared: unknowns that they share
    name TEXT NOT NULL,
    record BLOB NOT NULL, -- .npz: names of images; times of the orientation images, prior, how cameras are mounted; or
    -- what is shared, and a-priori sigmas
    PRIMARY KEY (kind, name)
) WITHOUT ROWID;

CREATE TABLE decision ( -- decisions of users about points; they hold for what is added later
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    change INTEGER NOT NULL REFERENCES change, -- who, when and why; it stands or is undone
    kind TEXT NOT NULL, -- measure, move, reject, accept, hold, release, remove
    point TEXT NOT NULL,
    image TEXT NOT NULL, -- empty for a decision about the point itself
    measure TEXT, -- JSON: the image measurement
    state TEXT -- JSON: the point without its measurements; NULL for a removed one
);

CREATE INDEX decision_of_point ON decision (point, number);
