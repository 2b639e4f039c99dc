"""What is wrong with a cell's host, ports and servos: looks, measures and says how to mend it."""
