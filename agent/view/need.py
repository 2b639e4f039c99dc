"""Whether the page in the browser can be had."""

from __future__ import annotations

from importlib.util import find_spec

from agent.view.error import ViewError


def need_viser() -> None:
    """Raise ViewError where viser is not installed."""
    if find_spec("viser") is None:
        raise ViewError(
            "the page needs viser", found="none", expected="the extra `view`",
            remedy="pip install 'widowx-coop[view]'; --film works without it",
        )  # fmt: skip
