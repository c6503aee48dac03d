"""A kept project: a folder with an SQLite file, to which images are added as they come."""
