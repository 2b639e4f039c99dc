"""What may stand under `[floating]` of a cell file: which arms float instead of working, so that a hand guides them.

With `others_move` the other arms carry the object meanwhile, those that float hold it and go with it.

`coop float` adds the table; a cell file that keeps it is one whose arms float whenever they are started.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, model_validator

from agent.config.schema.tolerance import Tolerance
from agent.config.schema.types import Name, Strict, wrong


class Floating(Strict):
    """Arms that are guided by hand: weight and part of their friction compensated, damped, limited in speed."""

    arms: Annotated[list[Name], Field(min_length=1, max_length=8)]
    """Arms that float."""
    holding: bool = False
    """Whether they hold the object: each then carries its load share too, its gripper closed on the object."""
    others_move: bool = False
    """Whether the other arms carry the object along the cell's motion, for a log that calibrates; needs `holding`."""
    speed_max_rad_per_s: Annotated[float, Field(ge=0.2, le=2.0)] = 1.0
    """From this speed of a joint on the arm resists as much as it stably can; at 2.5 times it stops."""
    friction_share: Annotated[float, Field(ge=0.0, le=0.9)] = 0.5
    """Part of the Coulomb friction in the arm files that is compensated; less than what friction must be at least."""
    drag_per_s: Annotated[float, Field(ge=1.0, le=10.0)] = 5.0
    """How quickly an arm that is let go comes to rest."""

    @model_validator(mode="after")
    def _different(self) -> Floating:
        if len(set(self.arms)) != len(self.arms):
            raise wrong("arms", found=", ".join(self.arms), expected="different arms", remedy="name each arm once")
        if self.others_move and not self.holding:
            raise wrong(
                "others_move", found="arms that float without the object", expected="holding = true",
                remedy="add it: what the others move is the object that all of them hold",
            )  # fmt: skip
        return self

    def moves(self, arm: str) -> bool:
        """Whether this arm of the cell carries the object while others float."""
        return self.others_move and arm not in self.arms

    def takes_part(self, arm: str) -> bool:
        """Whether this arm of the cell floats, or moves while others do."""
        return self.others_move or arm in self.arms

    def require_fit(self, arms: Sequence[str], tolerance: Tolerance) -> None:
        """Refuse arms that are not there, and a compensation that may exceed the friction.

        Raises PydanticCustomError.
        """
        for name in self.arms:
            if name not in arms:
                raise wrong("floating.arms", found=name, expected=" or ".join(arms), remedy="name arms of the cell")
        if self.others_move and set(arms) <= set(self.arms):
            raise wrong(
                "floating.arms", found=f"every arm ({', '.join(arms)})", expected="one left that moves the object",
                remedy="let fewer arms float, or leave out others_move (--others-move): a hand moves the object then",
            )  # fmt: skip
        least = tolerance.friction[0] / (1.0 + tolerance.torque_constant)
        if self.friction_share > least:
            raise wrong(
                "floating.friction_share", found=f"{self.friction_share:g}",
                expected=f"at most {least:.2g}: friction may be that part of the files' (tolerance.friction)",
                remedy="lower it, or an arm could move by itself",
            )  # fmt: skip
