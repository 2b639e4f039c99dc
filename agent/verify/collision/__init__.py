"""How near solid bodies of a cell come, and what is said of it."""
