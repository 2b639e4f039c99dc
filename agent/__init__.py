"""One arm's process, and the trades around it: configuration, verification, telemetry, logs, reports, tools."""
