"""What can fail and what must happen then: the list of faults, and cells in which they are made to happen."""
