"""The cell for ROS 2, live: standard messages made of telemetry in a separate process, published as rmw_zenoh does."""
