"""The file of a project: its layout's number, and the statements of `tables.sql`, which make an empty one.

SQLite keeps the comments: `sqlite3 project.sqlite .schema` explains the file. SI units, body-fixed metres, times in
seconds TDB past J2000. The user version is a checksum (`checksum.py`): whoever changes the file otherwise damages it.
Numbers stand in columns without a type: one of type REAL loses the sign of zero. NaN is NULL.
Blobs named so hold float64, little-endian, row by row; the others are NumPy archives (.npz).

Points, rays, ranges and stereo heights, of which there are millions, stand in packed columns (`columns.py`).
"""

from pathlib import Path

FORMAT = 10
"""Number of the layout; raised with every change of a table."""
APPLICATION = 0x4D475347
"""SQLite's application id ("MGSG"): by it the file is known as ours."""

TABLES = tuple(
    statement.rstrip(";\n")
    for statement in Path(__file__).with_name("tables.sql").read_text(encoding="utf-8").split("\n\n")
)
"""Statements that make an empty project."""
