"""`python -m mgsgraph.cli`."""

from mgsgraph.cli import main

main()
