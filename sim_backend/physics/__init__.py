"""The physics of the cell: closed chain, actuators, and the data they are built from."""
