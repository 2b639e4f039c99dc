"""Of the Dynamixel driver."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_SAVES_A_TEXT = "saves the making of a text that nobody is told"
_TAKES_ON = "if made.grip is not None and self.grip is not None:"
_SAME_GRIPPER = "the same arm has the same gripper; said for the type checker"
_NONE = "a function without a result returns None"
_READ_AFTER_A_JUMP = "read only after a jump, which sets it"
_SET_BY_A_QUESTION = "read while an answer is awaited only, and each question sets it"
_BOTH_ARE_LARGE = "both currents are large in the other half of the condition, so their product is not zero"
_ENDS = "if final or None not in found.values() or (again.finished if again is not None else first.finished):"
_NOTHING_TO_COUNT = "if None not in rows and (not damaged) and (not late):"
_BY_WORDS = "bytes do for every length; words are quicker where it is even"
_ENDS_OF_BLOCKS = "for end in range(self._block, blocks * self._block + 1, self._block):"
_NOTHING_TO_UNSTUFF = "saves counting and replacing what is not there"
_REGISTERS = "registers: Mapping[str, Register] = field(repr=False, compare=False)"
_OPPOSED = "opposed = followed[1] * shadow[1] < 0 and min(abs(followed[1]), abs(shadow[1])) >= self._fight"

_LARGEST_COUNT = "return round(share * (self.register(generic).maximum or 0))"
_NOISE = "reading.faults += self._noise.check(0 if cycle.late else heard)"

DRIVER: Entries = {
    "drivers.dynamixel.checks": {
        ("SilenceCheck.check", "if None not in rows:", "if False:"): "the short way for a cycle with all answers",
        ("SilenceCheck.check", "if any(missed):", "if True:"): "saves the making of a list of zeros",
        ("SilenceCheck.check", "return []", "pass"): "the short way for a cycle with all answers",
        (
            "SilenceCheck.__init__",
            "self._damaged = self._late = 0",
            "self._damaged = self._late = 1",
        ): "eight cycles pass before it is read, and in each it grows or becomes 0",
        ("JumpCheck.__init__", "self._jumped_rad = 0.0", "pass"): _READ_AFTER_A_JUMP,
        ("JumpCheck.__init__", "self._jumped_rad = 0.0", "self._jumped_rad = 1.0"): _READ_AFTER_A_JUMP,
        ("JumpCheck.__init__", "self.in_a_row = 0", "pass"): "the first angle, which is always believed, sets it",
        ("JumpCheck.__init__", "self.in_a_row = 0", "self.in_a_row = 1"): "the first angle, always believed, sets it",
        ("SpeedCheck.__init__", "self._found = 0.0", "pass"): "a speed beyond sets it before it is told",
        ("SpeedCheck.__init__", "self._found = 0.0", "self._found = 1.0"): "a speed beyond sets it before it is told",
        ("SpeedCheck.__init__", "self.in_a_row = 0", "pass"): "the first speed sets it",
        ("SpeedCheck.is_beyond", "if beyond:", "if True:"): "what is told is read behind one that is beyond",
        ("EffectCheck.check", "return None", "pass"): _NONE,
        (
            "PartCheck.check",
            "if found or tell.is_active(EventKind.PART_OF_CURRENT, slot.servo_id):",
            "if True:",
        ): _SAVES_A_TEXT,
        (
            "PairCheck.check",
            "if apart or tell.is_active(EventKind.PAIR_APART, slot.servo_id):",
            "if True:",
        ): _SAVES_A_TEXT,
        (
            "PairCheck.check",
            "if fighting or tell.is_active(EventKind.PAIR_FIGHTING, slot.servo_id):",
            "if True:",
        ): _SAVES_A_TEXT,
        (
            "PairCheck.check",
            _OPPOSED,
            _OPPOSED.replace("< 0", "<= 0"),
        ): _BOTH_ARE_LARGE,
        ("PairCheck.check", _OPPOSED, _OPPOSED.replace("< 0", "< 1")): _BOTH_ARE_LARGE,
    },
    "drivers.dynamixel.monitor": {
        (
            "GapMonitor._judge_status",
            "record.hardware = HardwareError(hardware) if hardware else NO_ERROR",
            "record.hardware = HardwareError(hardware) if True else NO_ERROR",
        ): "NO_ERROR is HardwareError(0), made once",
        (
            "GapMonitor._judge_status",
            "if hardware and record.hardware & record.shutdown:",
            "if True and record.hardware & record.shutdown:",
        ): "without an error there is no bit to stop it; saves the question",
        (
            "GapMonitor._judge_status",
            "if hardware or self._tell.is_active(EventKind.HARDWARE_WARNING, record.slot.servo_id):",
            "if True:",
        ): _SAVES_A_TEXT,
    },
    "drivers.dynamixel.line.group": {
        (
            "GroupRead._parse_fast",
            "start = data.find(self._head, start + 8)",
            "start = data.find(self._head, start + 7)",
        ): "a head does not begin with the byte that ends it",
        ("GroupRead._intact", "if self._block & 1:", "if True:"): _BY_WORDS,
        ("GroupRead._intact", "if self._block & 1:", "if self._block | 1:"): _BY_WORDS,
        ("GroupRead._intact", _ENDS_OF_BLOCKS, _ENDS_OF_BLOCKS.replace("+ 1", "+ 2")): "a block is longer than 2 bytes",
        (
            "GroupWrite.__init__",
            "self._arguments = [value for servo_id in ids for value in (servo_id, 0)]",
            "self._arguments = [value for servo_id in ids for value in (servo_id, 1)]",
        ): "each packet puts its own values there",
        (
            "GroupWrite.packet",
            "if b'\\xff\\xff\\xfd' in params:",
            "if True:",
        ): "the general builder gives the same bytes, slower (test_group)",
    },
    "drivers.dynamixel.cycle": {
        (
            "CycleReader.__init__",
            "self._fast_groups = marked_groups(self._ids, fast=True) if fast else []",
            "self._fast_groups = marked_groups(self._ids, fast=True) if True else []",
        ): "saves the making of groups that are not asked for",
        (
            "CycleReader.__init__",
            "self._careful_fits = careful.read_worst_s * 1000000000.0 < self.end_ns",
            "self._careful_fits = careful.read_worst_s * 1000000000.0 <= self.end_ns",
        ): "a sum of fractions is compared with a whole number of nanoseconds",
        (
            "CycleReader._listen",
            "if final or group.worth_parsing(heard):",
            "if True:",
        ): "saves the parsing of what cannot be whole",
        ("CycleReader._ask_again", _ENDS, _ENDS.replace("final", "False")): "what is final is finished",
        ("CycleReader._count", _NOTHING_TO_COUNT, "if False:"): "the short way for a cycle with all answers",
        ("CycleReader._count", "return", "pass"): "the short way for a cycle with all answers",
        (
            "_group",
            "fields = (f'{more}x' if more else '') + 'hii'",
            "fields = (f'{more}x' if True else '') + 'hii'",
        ): "0x is no byte",
        (
            "marked_groups",
            "if fast and 2 * len(ids) >= MARKS:",
            "if fast and 2 * len(ids) > MARKS:",
        ): "MARKS is odd",
    },
    "drivers.dynamixel.driver": {
        (
            "DynamixelDriver.__init__",
            "self._begin_ns = 0",
            "self._begin_ns = 1",
        ): "before the first read either is an instant long past",
    },
    "drivers.dynamixel.interpret": {
        (
            "Interpreter.__init__",
            "self._unseen_cycles = [0] * len(drives)",
            "self._unseen_cycles = [1] * len(drives)",
        ): "until a joint is seen first its speed is zero, and then this is zero, too",
    },
    "drivers.dynamixel.line.codec": {
        ("unstuff", "if _UNSTUFFED not in body:", "if False:"): _NOTHING_TO_UNSTUFF,
        ("unstuff", "return body", "pass"): _NOTHING_TO_UNSTUFF,
        ("StatusScanner.feed", "if excess > 0:", "if excess >= 0:"): "drops nothing where nothing is too much",
    },
    "drivers.dynamixel.servo.models": {
        ("ServoModel.share_count", _LARGEST_COUNT, _LARGEST_COUNT.replace("or 0", "or False")): "False is zero",
        ("ServoModel", _REGISTERS, _REGISTERS.replace("repr=False", "repr=True")): "how it is printed",
    },
    "drivers.dynamixel.servo.units": {
        ("", "if TYPE_CHECKING:", "if False:"): "said for the type checker",
    },
    "drivers.dynamixel.identify": {
        ("_at_another_speed", "return None", "pass"): _NONE,
    },
    "drivers.dynamixel.running": {
        ("Running.interpret", _NOISE, _NOISE.replace("0 if", "1 if")): "one byte is no noise either",
        ("Running.again", _TAKES_ON, _TAKES_ON.replace("made.grip is not None", "True")): _SAME_GRIPPER,
        ("Running.again", _TAKES_ON, _TAKES_ON.replace("self.grip is not None", "True")): _SAME_GRIPPER,
        ("Running.again", _TAKES_ON, _TAKES_ON.replace(" and ", " or ")): _SAME_GRIPPER,
        (
            "Running.recognise",
            "first = self._found[0]",
            "first = self._found[1]",
        ): "every servo of an arm has its mark",
        ("Running.__init__", "self._wire_free_ns = 0", "pass"): _SET_BY_A_QUESTION,
        ("Running.__init__", "self._wire_free_ns = 0", "self._wire_free_ns = 1"): _SET_BY_A_QUESTION,
        (
            "Running.write",
            "sent = [0.0] * len(tau_Nm)",
            "sent = [1.0] * len(tau_Nm)",
        ): "each joint has a writer, which fills its place",
    },
}
