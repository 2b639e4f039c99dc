"""Identification: friction, rotor inertia and gravity parameters of an arm from a log."""
