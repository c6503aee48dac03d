"""What all writers of results share: folders that appear whole or not at all, CSV, JSON and GeoTIFF files."""
