"""The studio: a local page on which a person looks at a block, measures in it and asks its posterior."""
