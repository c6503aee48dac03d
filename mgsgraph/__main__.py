"""`python -m mgsgraph`."""

from mgsgraph.cli import main

main()
