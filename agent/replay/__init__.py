"""A log through the control law again: whether it gives the recorded torque, and what another cell would have given."""
