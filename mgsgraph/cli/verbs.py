"""All verbs of the command line in the groups of the help: the module of each verb's function, and its line of help."""

GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "Start": {
        "demo": ("sources", "Simulate a study site, adjust it, and compare the result with the truth."),
        "fetch": ("sources", "Fetch images, kernels, laser profiles and terrain from the archives."),
        "simulate": ("sources", "Write the files of a simulated study site, in the formats of the mission's archive."),
        "new": ("new", "Write a case file for the files that you have; list the keys of a case file."),
        "check": ("cases", "Read and validate a case, say what is in it, solve nothing."),
        "split": ("cases", "Divide a case into cases of connected images, for `batch`."),
        "match": ("sources", "Find tie points in the images themselves."),
    },
    "Adjust": {
        "adjust": ("cases", "Adjust a case: orientation, ground points and their sigmas."),
        "align": ("cases", "Align laser profiles, terrain models and images by relief, in the adjustment."),
        "batch": ("cases", "Adjust many cases, here or on a cluster, with a record of what is done."),
    },
    "Inspect": {
        "analyze": ("questions", "Query the covariance: sigmas, reliability, least-constrained directions, nodes."),
        "report": ("questions", "Write a page about an adjustment, one HTML file; compare it with another one."),
        "locate": ("places", "Go from ground coordinates to pixels of an image, or from pixels to the ground."),
        "footprints": ("places", "Find laser footprints in images, and compare the images at them."),
        "plan": ("questions", "Rank what might be observed next by what it would do to the sigmas."),
        "studio": ("projects", "Look at a project, results or a case in the browser, measure, ask, judge tie points."),
    },
    "Projects": {
        "project init": ("projects", "Make a project, to which images are added as they come."),
        "project add": ("projects", "Add images to a project, and adjust what they touch."),
        "project remove": ("projects", "Take images out of a project, and adjust what they touched."),
        "project measure": ("projects", "Measure a point of a project, reject or accept a measure, and adjust."),
        "project undo": ("projects", "Undo the last change of a project."),
        "project redo": ("projects", "Carry out again the change that undo took back."),
        "project solve": ("projects", "Adjust everything in a project by batch, and compare."),
        "project status": ("projects", "Say what is in a project and what its last solution was."),
    },
    "Take along": {
        "export": ("networks", "Write a solution for other programs: SPICE, CSM, ISIS and its cubes, ASP, GIS."),
        "convert": ("networks", "Convert control networks and tie points: ISIS, Ames Stereo Pipeline, tables."),
        "dem": ("sources", "Make a terrain model with sigmas and an ortho image from adjusted images."),
    },
}  # fmt: skip
"""Module of each verb, and its line of help: known before that module is imported."""
VERBS = {verb: line for group in GROUPS.values() for verb, line in group.items()}
RENAMED = {
    "campaign": "mgsgraph batch",
    "compare": "mgsgraph report RESULT --compare EARLIER",
    "coregister": "mgsgraph align",
    "help": "mgsgraph VERB --help; the keys of a case file: mgsgraph new --keys",
    "nodes": "mgsgraph analyze CASE --nodes",
    "register": "mgsgraph footprints CASE",
    "review": "mgsgraph studio CASE --verdicts FILE.csv",
    "shots": "mgsgraph footprints CASE FILES",
    **{verb.removeprefix("project "): f"mgsgraph {verb}" for verb in GROUPS["Projects"]},
}
"""What verbs of version 0.2 are called now."""
REMOVED = {
    "adjust --relief": "mgsgraph align CASE",
    "adjust --two-steps": "two calls: of CASE with `control = false` in its [terrain], and of CASE (docs/terrain.md)",
    "align --reach": "--search",
    "align --solution": "mgsgraph align RESULT, with --case CASE where RESULT doesn't know it",
    "analyze --cell-m": "--post",
    "analyze --poses": "--pose once for each, with --correlations",
    "analyze --snoop": "mgsgraph adjust CASE --reject, with the critical value that --reliability says",
    "convert --images": "--size",
    "convert --only": "--image",
    "convert --split": "mgsgraph split CASE, which divides the network with its images",
    "convert --target": "--body",
    "convert --thin": "ISIS's cnetthinner keeps few points, well spread; --image keeps some images",
    "dem --mola": "--shots",
    "export --network": "--ties",
    "fetch --dry-run": "the archives' pages have sizes; an interrupted fetch goes on where it was",
    "fetch --mirrors": "--mirror takes a file of addresses, too",
    "fetch --shots": "--altimeter",
    "fetch --update": "to have what the archives have now, fetch into another folder",
    "fetch --verify": "the same fetch again holds the folder against its lock, and brings what differs",
    "footprints --solution": "mgsgraph footprints RESULT, with --case CASE where RESULT doesn't know it",
    "locate --place": "--ground",
    "studio --point": "the studio lists all points, with a filter for their names",
    "studio --review": "mgsgraph studio CASE to judge, mgsgraph convert NETWORK OUT --verdicts CSV to apply",
    "studio --worst": "the studio lists all points, sorted by any column",
    "match --method": "features alone are matched; for more of them, --per-cell",
    **{f"{verb} --check": "`project solve` ends with the check against batch" for verb in ("add", "remove")},
    **{f"{verb} --form": "always eliminated; in GTSAM: mgsgraph.factor_graph" for verb in ("adjust", "batch")},
    **{f"{verb} --pair": "--image A --image B" for verb in ("align", "dem")},
    **{f"{verb} --verbose": "-v, which prints the tables too" for verb in ("adjust", "batch", "solve")},
}
"""Options that verbs had once, and what serves instead."""
