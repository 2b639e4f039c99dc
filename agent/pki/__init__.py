"""Certificates of a cell and the Zenoh configurations that go with them."""
