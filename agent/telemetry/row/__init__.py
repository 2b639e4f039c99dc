"""What is told of each tick: the row, events, and the table of keys and topics."""
