"""Long comparisons: predictions of `coop check` with simulated cells, and each phase of a session with its mishaps."""
