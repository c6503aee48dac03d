"""What a network leaves undetermined, in words: transformations of the whole of it, and weak directions of its images."""
