"""Arm descriptions, cells and viewers' layouts that ship with the product, and where they lie."""

from pathlib import Path

ARMS_DIR = Path(__file__).parent / "arms"
CELLS_DIR = Path(__file__).parent / "cells"
LAYOUTS_DIR = Path(__file__).parent / "layouts"
