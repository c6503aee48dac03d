"""A case file (TOML): inputs of an adjustment and what is known of them beforehand, and how it becomes a network."""
