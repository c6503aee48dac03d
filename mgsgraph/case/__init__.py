"""A case file (TOML): inputs of an adjustment and their a-priori values, and how it becomes a network."""
