"""Ticks without a state: how many there were before this one, and what is made of them; pure.

What an arm does by the age of its mode goes on by the clock while it misses single ticks: a way that waited for them
would lie behind the speed that it asks for.  Over MANY it waits, for nobody knows what the arm did meanwhile.

Missed once, the hold goes on as it was: only the law knows what the arm carries beyond its share, as of a limp
neighbour.  Its observer begins anew, for it expects the next period.  Missed again before that is forgotten, the law
itself would shake the arm, and the hold is gentle.
"""

from __future__ import annotations

from agent.calm import JOINTS
from agent.control.memory import Memory

GENTLE_TICKS = 100  # with a state in time, until a hold that was starved is as stiff as its joints allow
STARVED_PERIODS, MANY = 3.5, 4  # from one state to the next, above which an arm has missed some
FORGIVEN_TICKS = 20  # with a state in time, until that is forgotten; a hold that misses some again before is gentle


def periods(period_s: float, t: float, memory: Memory) -> int:
    """Since the last tick that had a state; MANY: it is not to be worked out what has been meanwhile."""
    passed = t - memory.t
    return MANY if passed > STARVED_PERIODS * period_s else 1 + (passed > 1.5 * period_s) + (passed > 2.5 * period_s)


def caught_up(period_s: float, t: float, memory: Memory) -> Memory:
    """Memory of a mode that goes by its age, as old at t as it would be with a state in every tick before."""
    since = periods(period_s, t, memory)
    return memory if since == MANY else memory._replace(age=memory.age + (since - 1) * period_s)


def in_time(period_s: float, t: float, memory: Memory) -> Memory:
    """Memory of a hold that has a state at t, and knows for a while that it had none for some cycles."""
    if periods(period_s, t, memory) == MANY:
        again = memory.missed or memory.calm > JOINTS
        calm = JOINTS + GENTLE_TICKS + 1 if again else memory.calm
        return memory._replace(primed=False, calm=calm, missed=FORGIVEN_TICKS)
    return memory._replace(missed=memory.missed - 1) if memory.missed else memory
