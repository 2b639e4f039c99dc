"""Arm descriptions and cells that ship with the product; this package only says where they are."""

from pathlib import Path

ARMS_DIR = Path(__file__).parent / "arms"
CELLS_DIR = Path(__file__).parent / "cells"
