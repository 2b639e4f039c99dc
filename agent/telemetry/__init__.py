"""Live telemetry: from the control loop's row through the ring to Zenoh and the recorder."""
