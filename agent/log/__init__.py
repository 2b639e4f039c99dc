"""MCAP logs: write, read, scan, recover."""
