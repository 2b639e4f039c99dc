"""The simulated cell: plant, actuators, server and the driver that reaches it; never imports `agent`."""
