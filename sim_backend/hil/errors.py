"""Why a real arm and its twin in the simulated cell are apart."""

from __future__ import annotations

from drivers.interface import JointState, ServoFault


class HilFault(ServoFault):
    """The rehearsal of this arm is over: it moves by itself from here on, without the object's part.

    A `ServoFault` with the arm's fresh state, so that the loop holds it.
    """

    def with_state(self, state: JointState) -> HilFault:
        """The same with a fresh state of the arm."""
        fault = HilFault(self.what, found=self.found, expected=self.expected, remedy=self.remedy)
        fault.state = state
        return fault
