"""Long comparisons of what `coop check` predicts with what the simulated cell does."""
