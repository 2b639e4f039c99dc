"""Many realities of a cell, each a whole run of its controllers in one process, and what they say together."""
