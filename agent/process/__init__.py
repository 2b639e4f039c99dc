"""Composition roots: one module per process of a cell."""
