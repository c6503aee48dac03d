"""What to observe next: candidates ranked by what they would do to the sigmas, before anything is measured."""
