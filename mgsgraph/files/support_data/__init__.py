"""CSM image support data (ISD, JSON) and model states: read, compared with their keywords, written."""
