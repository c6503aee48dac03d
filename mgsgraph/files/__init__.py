"""The only place that knows file formats and SPICE. Kilometres, degrees and 1-based pixels end here."""
