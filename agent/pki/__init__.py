"""Certificates of a cell and the Zenoh configurations that go with them."""

from typing import Final

PORT: Final = 7447  # of a recorder that several hosts dial, unless another is asked for
