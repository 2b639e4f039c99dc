"""ROS messages of any reader as numbers, texts and lists, to compare them."""

from __future__ import annotations

import numpy as np


def plain(message: object) -> object:
    """NaN becomes a word, for nothing equals it; constants of a type are left out."""
    if isinstance(message, str):
        return message
    if isinstance(message, np.ndarray | list | tuple):
        return [plain(part) for part in message]
    if isinstance(message, int | float | np.number):
        return "NaN" if np.isnan(message) else float(message)
    names = [n for n in getattr(message, "__slots__", None) or vars(message) if not (n.startswith("_") or n.isupper())]
    return {n: plain(getattr(message, n)) for n in names}
