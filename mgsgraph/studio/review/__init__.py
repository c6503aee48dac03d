"""Tie points shown to a person on a page, and what becomes of that person's verdicts."""
