"""A simulated site from its files to its results, compared with the truth; what `mgsgraph simulate` offers."""
