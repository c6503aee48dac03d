"""What `reproduce_papers.py` says about its tables: what is comparable, and what a simulation can't match, and why."""

HEAD = """# The papers' tables, simulated

Made by `scripts/reproduce_papers.py --seed {seed}`: simulated sites with the published geometry, the case `papers`
(observations and weights of Yoon & Shan 2005). Published numbers: `scripts/published.py`. RMSE is the spread about the
mean, as in the papers. Truth is known here; their data are not: numbers that geometry and weights alone determine must
agree, numbers that the errors of the kernels determine can't.
"""
TABLE_1 = """By construction. At Eos 17.97 deg and a base-to-height ratio of 0.41 exclude each other (see Shan's
orientation below).
"""
TABLE_2 = """Means can't match: the real errors of the kernels are unknown, and *injected* (truth minus SPICE) stands in
their place. Position and pointing move the image alike, so that the adjustment splits one correction between them by
their sigmas, and, as phi lies between -75 and -85 deg, also between omega and kappa: the papers' case doesn't find the
injected elements one by one, and neither can theirs have. Comparable are the orders of magnitude, the opposite signs of
the pair, and the RMSE of the angles at Gusev and Isidis, which is the noise of the CK. Eos' errors are those that
`simulation/sites.py` states; the published 417.8 m and 20' there lie in directions that a pair leaves undetermined, and
are not expected.
"""
TABLE_3 = """Ties depend on the kernels' errors: not comparable but in size. Footprints hardly move in either (10 m a
priori, ranges 10 m).
"""
TABLE_4 = """Predicted sigmas depend on geometry and weights only and are comparable (ours are for sigma0 = 1, theirs
contain a sigma0 of 1.01 to 1.06). sigma0 is not: simulated ranges and footprints are better than their a-priori 10 m,
and back-projected rows have no noise. But the published sigma0, Table 5 and the residuals of ties belong together only
with other sigmas of MOLA's image points than the "approximately 30 pixels" of the text (every footprint counted in both
images):
"""
IMPLIED = """At Gusev that accounts for the tie sigmas in which the case falls short; at Isidis it mends X and Z and
spoils Y; at Eos it spoils them. The case keeps what the papers state: 30 px, and at Eos the 125 px and unit trends of
`simulation/case_files.py`, without which its tie sigmas are a quarter of the published ones.
"""
TABLE_5 = """The corrections of the two images together make up the injected relative error: comparable. The split
follows from the weights, about equal in pixels; the published one at Isidis is another (35 to 25 px), so that
footprints or weights there were not quite those of the text. Across the flight, in the epipolar plane, an error lifts
the ties and leaves no contradiction: corrections are near zero here, and theirs of 3 px stay unexplained. RMSE is what
the kernels' errors vary by along the image. The residuals of ties along the flight are those of 1 px noise; across it,
the ground point of a pair takes them up.
"""
RANGES = """Simulated ranges have 1 m of noise, the SPK 10 to 20 m in height; published ones depend on both.
"""
SHIFT = """Table 5 implies 228 m (Gusev; 229 in the plan) and 225 m (Isidis), not the 325 m of the text. The simulation
follows the table; the option of 0.95 s follows the text.
"""
WEIGHTS = """PE&RS: "moderate changes in weight magnitude yield practically the same results".
"""
EOS = """The nadir image's published start Y is a misprint (11 km too far out; -2436.1 fits). The simulation places both
images over one middle and flies them through it on a smooth orbit, so that it can agree to some km and tenths of a
degree: with 22 deg of emission it does, with Table 1's 17.97 deg the off-nadir camera stands elsewhere.
"""
FOOTPRINTS = """Simulated: where the track of the off-nadir image's profile has the published latitude; its relief and
its exact place are invented.
"""
