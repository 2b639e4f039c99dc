"""The plant as a process: protocol, server, and the driver that reaches it."""
