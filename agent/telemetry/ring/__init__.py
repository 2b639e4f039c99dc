"""The shared-memory ring between the control thread and telemetry."""
