"""What is wrong with a cell's host, ports and servos: looked at, measured, and how to mend it."""
