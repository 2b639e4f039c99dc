"""Composition roots: the only files that name concrete drivers, clocks, rings and servers."""
