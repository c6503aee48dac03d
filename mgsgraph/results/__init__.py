"""What is said and written of an adjustment: tables, sentences, the page, the archive, the inventory of a case."""
