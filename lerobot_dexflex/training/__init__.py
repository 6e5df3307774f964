"""What trainings need besides the networks."""
