"""The guard of one arm: what goes on in HOLD when the agent is gone, and the line between the two processes."""
