"""Live operation: a person's hand leads the robot's, tick by tick, and what it does becomes a dataset."""
