"""The serial line: port, packets, group reads and writes."""
