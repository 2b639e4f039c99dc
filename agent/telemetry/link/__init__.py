"""The network side of telemetry: publish, record, play."""
