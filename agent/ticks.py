"""When the ticks of a loop are, on its driver's clock: the next deadline, the trajectory's zero and its end."""

from __future__ import annotations

from agent.around import Schedule

NOT_YET_NS = 86_400_000_000_000  # the time in rows while nobody has given a start: it counts towards a day ahead


class Ticks:
    """deadline_ns: of this tick, and of the next one once it has passed; zero_ns: of the trajectory."""

    def __init__(self, schedule: Schedule, begin_ns: int) -> None:
        self.deadline_ns = begin_ns
        self.zero_ns = begin_ns + (schedule.ready_ns if schedule.lockstep else NOT_YET_NS)
        self._period_ns = schedule.period_ns
        self._length_ns = schedule.ticks * schedule.period_ns
        self._endless = schedule.hold_at_end
        self._begins = self._lockstep = schedule.lockstep  # whether it does at its zero, which else nobody has given

    def over(self) -> bool:
        """Whether there is no tick any more."""
        return not self._endless and self.past_end(self.deadline_ns)

    def past_end(self, instant_ns: int) -> bool:
        """Whether the trajectory has ended by then."""
        return instant_ns - self.zero_ns >= self._length_ns

    def start(self, zero_ns: int) -> None:
        """The trajectory begins at this instant: this tick's deadline moves to a whole number of periods before it."""
        self.deadline_ns = zero_ns - (zero_ns - self.deadline_ns) // self._period_ns * self._period_ns
        self.zero_ns, self._begins = zero_ns, True

    def await_start(self, now_ns: int) -> None:
        """What was started is over, or taken back; nobody has set another zero."""
        self.zero_ns, self._begins = now_ns + NOT_YET_NS, False

    def take_back(self, now_ns: int) -> None:
        """No start is given any more; without effect where none was."""
        if self._begins and not self._lockstep:
            self.await_start(now_ns)

    def starts_next(self) -> bool:
        """Whether the next tick belongs to the trajectory: never, as long as nobody has given a start."""
        return self._begins and self.deadline_ns + self._period_ns >= self.zero_ns

    def told(self, t: float) -> str:
        """An instant (s) of the trajectory in front of what happened then; in words where it has no zero yet."""
        return f"t = {t:.3f} s: " if t > -0.5e-9 * NOT_YET_NS else "before a start: "
