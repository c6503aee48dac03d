"""What `reproduce_papers.py` says about its tables: what is comparable, and what a simulation can't match, and why."""

HEAD = """# The papers' tables, simulated

Made by `scripts/reproduce_papers.py --seed {seed}`: simulated sites with the published geometry, the case `papers`
(observations and weights of Yoon & Shan 2005; of MOLA's image points the weights that balance their Table 5, below).
Published numbers: `scripts/published.py`. RMSE is the spread about the mean, as in the papers. Truth is known here;
their data are not: numbers that geometry and weights alone determine must agree, numbers that the errors of the
kernels determine can't.
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
TABLE_4 = """*Predicted* sigmas are for sigma0 = 1; the published ones contain sigma0, and are to be compared with
*times sigma0*. sigma0 is as PE&RS counts it: "computed from the residuals of the measurements", which are image
points and ranges, less all unknowns; the last column has it of all rows. Nothing here is fitted to Table 4: MOLA's
image sigmas follow from Table 5 and the residuals of ties (next table), the noise of ties from these residuals
({noise:.2f} px, pooled), the polynomials' trends from the RMSE of the positions in Table 2 (1, 0.02, 0.002; at Eos 1,
1, 1; with 1, 0.1, 0.01 Gusev's ties would be 1.6 times theirs in Y), and the kernels' errors are those of
`simulation/sites.py`.
"""
BALANCE = """At the solution footprints and ties pull each image with equal force, so that T mean(tie residual) = N
mean(MOLA correction) / sigma^2 in each image and coordinate: ISPRS Table 3 has both means. At Gusev all four
coordinates give 22 px, at Isidis 26 to 31 px. At Eos the images differ, and y of the right image has a sigma four to
five times that of x: the 47 px there go with residuals of ties of 0.002 px, a digit that is good to a quarter (143 to
185 px inside the image, and factors of 1.2 to 1.55 of the ties' sigma in X). With these sigmas sigma0 follows from
the published residuals within {worst:.0f}% at all three sites, if every footprint counts in both images. Simulated
images end before some footprints of the other profile.
"""
CONTRADICTIONS = """The "approximately 30 pixels" hold at Isidis alone. A sigma for each image and coordinate isn't in
the text, but without it neither Eos' tie sigmas nor its sigma0 come out. ISPRS: the sigmas "are based on the previous
analysis about the MOLA registration". A case file has one sigma for a profile's image points (`image_sigma_px`):
`case_papers.toml` has 40, 22 and 30 px, and this script puts those of the table in their place.
"""
TABLE_5 = """The corrections of the two images together make up the injected relative error: comparable. The split
follows from weights and counts, here about equal in pixels. The published one at Isidis is another (35 to 25 px), and
so is the ratio of the ties' residuals in the two images: both are what Table 1 gives if its two pixel sizes there
(3.3 and 4.4 m) are exchanged. Across the flight, in the epipolar plane, an error lifts the ties and leaves no
contradiction: corrections are near zero here. Theirs of 3 px have to those in x the ratio that the ties' residuals
have (Gusev -0.14 and -0.11, of ties -0.14 and -0.10; Isidis -0.08 and -0.12, of ties -0.07 and -0.15): one
contradiction, which lies a few degrees off the flight since the line planes of the two cameras are not quite
parallel. Simulated cameras differ by a roll alone. RMSE is what the kernels' errors vary by along the image. The
residuals of ties along the flight are those of 1 px noise; across it, the ground point of a pair takes them up.
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
