"""When the ticks of a loop are, on its driver's clock: the next deadline, the trajectory's zero and its end."""

from __future__ import annotations

from agent.around import Schedule

NOT_YET_NS = 86_400_000_000_000  # the trajectory's zero while nobody has set it: a day ahead


class Ticks:
    """deadline_ns: of this tick, and of the next one once it has passed; zero_ns: of the trajectory."""

    def __init__(self, schedule: Schedule, begin_ns: int) -> None:
        self.deadline_ns = begin_ns
        self.zero_ns = begin_ns + (schedule.ready_ns if schedule.lockstep else NOT_YET_NS)
        self._period_ns = schedule.period_ns
        self._length_ns = schedule.ticks * schedule.period_ns
        self._endless = schedule.hold_at_end

    def over(self) -> bool:
        """Whether there is no tick any more."""
        return not self._endless and self.past_end(self.deadline_ns)

    def past_end(self, instant_ns: int) -> bool:
        """Whether the trajectory has ended by then."""
        return instant_ns - self.zero_ns >= self._length_ns

    def start(self, zero_ns: int) -> None:
        """The trajectory begins at this instant: this tick's deadline moves to a whole number of periods before it."""
        self.deadline_ns = zero_ns - (zero_ns - self.deadline_ns) // self._period_ns * self._period_ns
        self.zero_ns = zero_ns

    def await_start(self, now_ns: int) -> None:
        """What was started is over; nobody has set another zero."""
        self.zero_ns = now_ns + NOT_YET_NS

    def starts_next(self) -> bool:
        """Whether the next tick belongs to the trajectory."""
        return self.deadline_ns + self._period_ns >= self.zero_ns
