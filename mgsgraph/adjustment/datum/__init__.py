"""What a network leaves undetermined, in words: transformations of the whole, and weak directions of images."""
