"""All verbs of the command line: in which module of this room each is a function, and its line of help."""

VERBS = {
    "add": ("projects", "Add images to a project, and adjust what they touch."),
    "adjust": ("cases", "Adjust a case: orientation, ground points and their sigmas."),
    "analyze": ("questions", "Ask the covariance of an adjustment: sigmas, honesty, reliability, what is weak."),
    "check": ("cases", "Read and validate a case, say what is in it, solve nothing."),
    "compare": ("questions", "Say how two solutions differ: settings, input, what moved by how many sigmas."),
    "convert": ("networks", "Convert control networks and tie points: ISIS, Ames Stereo Pipeline, tables."),
    "coregister": ("cases", "Move laser, terrain models and images onto each other by relief, in the adjustment."),
    "campaign": ("cases", "Adjust many cases, here or on a cluster, with a record of what is done."),
    "dem": ("sources", "Make a terrain model with sigmas and an ortho image from adjusted images."),
    "demo": ("sources", "Simulate a study site, adjust it, and say what was wrong and what is right now."),
    "export": ("networks", "Write a solution for other programs: SPICE, CSM, ISIS, Ames Stereo Pipeline, GIS."),
    "fetch": ("sources", "Fetch images, kernels, laser profiles and terrain from the archives."),
    "help": ("new", "Say what a verb takes, or every key of a case file: mgsgraph help case [TABLE]."),
    "init": ("projects", "Make a project, to which images are added as they come."),
    "match": ("sources", "Find tie points in the images themselves."),
    "measure": ("projects", "Measure a point of a project, reject or accept a measure, and adjust."),
    "new": ("new", "Write a case file for the files that one has: images, networks, shots, terrain, kernels."),
    "nodes": ("cases", "Choose how close orientation images stand from the data, and look for vibrations."),
    "plan": ("questions", "Rank what might be observed next by what it would do to the sigmas."),
    "project": ("places", "Project ground places into an image, or image places onto ellipsoid or terrain."),
    "register": ("cases", "Project laser footprints into the images, and say by how much the images contradict."),
    "remove": ("projects", "Take images out of a project, and adjust what they touched."),
    "report": ("questions", "Write a page about an adjustment, one HTML file."),
    "review": ("networks", "Show tie points to a person, and take rejected ones out of a network."),
    "shots": ("places", "Find the laser profiles over images, and those taken along with them."),
    "simulate": ("sources", "Write the files of a simulated study site, in the formats of the mission's archive."),
    "solve": ("projects", "Adjust everything in a project by batch, and compare."),
    "studio": ("projects", "Look at a project, results or a case in the browser, measure and ask."),
    "status": ("projects", "Say what is in a project and what its last solution was."),
    "undo": ("projects", "Take back the last edit of a point of a project."),
}
"""Module of each verb, and its line of help: known before that module is imported."""

REMOVED = {
    "adjust --form": "points are always eliminated, to the same result",
    "campaign --form": "points are always eliminated, to the same result",
    "adjust --relief": "mgsgraph coregister CASE",
    "add --check": "mgsgraph solve PROJECT ends with the closing check",
    "remove --check": "mgsgraph solve PROJECT ends with the closing check",
    "fetch --dry-run": "the archives' pages have sizes; an interrupted fetch goes on where it was",
}
"""Options that verbs had once, and what serves instead."""
