"""Hardware in the loop: a real arm that holds nothing, coupled to its twin in the simulated cell."""
