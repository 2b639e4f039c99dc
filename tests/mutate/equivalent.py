"""Changes that change nothing a test could see, each with the reason; whoever adds one has tried to write the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tests.mutate.mutants import Mutant

Key = tuple[str, str, str]  # where, first line of the statement before and after

_SAVES_A_TEXT = "saves the making of a text that nobody is told"
_SAVES_A_CALL = "saves a call: joining no flag changes nothing"
_TAKES_ON = "if made.grip is not None and self.grip is not None:"
_SAME_GRIPPER = "the same arm has the same gripper; said for the type checker"
_BRAKES = "brake = brake_per_s(agent.period_s) if damped else 0.0"
_WHILE_IT_BRAKES = "read only while the arm brakes"
_ALONE_IN = "alone = session is not None and mode in phases.ALONE"
_LIMITED = (
    "tau, flags = limit(wanted.tolist(), memory.tau.tolist(), "
    "session.limits if session is not None and alone else agent.limits)"
)
_OFF = "if session is not None and alone and (phases.off(session.life, mode, memory, q) > session.life.off_max_rad):"
_WITH_A_SESSION = "asked for twice, for the type checker: whoever is alone has a session"
_PART = "part = 1.0 if life is None else phases.handing_over(life, mode, memory)"
_LEARNS = "if adaptation is None or estimate is None:"
_BOTH = "who learns has an estimate; said for the type checker"
_NONE = "a function without a result returns None"
_READ_AFTER_A_JUMP = "read only after a jump, which sets it"
_SET_BY_A_QUESTION = "read while an answer is awaited only, and each question sets it"
_BOTH_ARE_LARGE = "both currents are large in the other half of the condition, so their product is not zero"
_ENDS = "if final or None not in found.values() or (again.finished if again is not None else first.finished):"
_NOTHING_TO_COUNT = "if None not in rows and (not damaged) and (not late):"
_OPENS = "fd = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 416)"
_FCHMOD = "the next line sets the mode, before anything is in the file"
_HAS_SPACE = "if self.written - self._words[ACKNOWLEDGED_WORD] < enough:"
_NO_CLOCK = "the short way, without asking the clock; the loop behind it ends as soon"
_TEXTS = "while (block := self._ring.read_new(64)).count:"
_INTACT = "intact = (copy.view(np.uint64)[:, 0] == expected) & (live_index[where] == expected)"
_ROOM = "memory = np.zeros(dtype.itemsize + 16, np.uint8)"
_STANDARD_INPUT = "descriptor 0 is a process's standard input"
_TABLE = "_FLAGS = tuple(map(Flag, range((_NOT_FINITE | _SATURATED | _RATE_LIMITED) + 1)))"
_MAPPED = "return mmap.mmap(fd, size, mmap.MAP_SHARED | (mmap.MAP_POPULATE if at_once else 0), protection)"
_BY_WORDS = "bytes do for every length; words are quicker where it is even"
_ENDS_OF_BLOCKS = "for end in range(self._block, blocks * self._block + 1, self._block):"
_OPPOSED = "opposed = followed[1] * shadow[1] < 0 and min(abs(followed[1]), abs(shadow[1])) >= self._fight"

_COMMON = "_, i, j = np.intersect1d(a['sequence'], b['sequence'], assume_unique=True, return_indices=True)"
_ENCODED = "rows = [np.ascontiguousarray(part.messages()).reshape(-1).view(layout.dtype) for part in (one, other)]"
_BYTES = "x, y = (np.ascontiguousarray(rows[name]).view(np.uint8).reshape(len(rows), -1) for rows in (a, b))"
_NO_ROW = "self._row = self._marked = -1"
_STEP = "step = round(float(self._t[1] - self._t[0]), 6) if len(self._t) > 1 else 1.0"
_IDLE = "if self._wanted_s is None:"
_PLAYING = "if t is None and started is not None:"
_AT_END = "if started is not None and self._row == len(self._t) - 1:"
_TELLS = "if row != self._told and (self._told < 0 or now - self._told_s >= WORDS_S):"
_MIDDLE = "middle = look_at + 0.5 * (y.max() + y.min()) * Camera(look_at + back, look_at, up).axes[1]"
_ALONE = "if np.linalg.norm(along) < 1e-06:"
_ACROSS = "along = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])"
_SIZED = "sized = np.where(np.isfinite(values), np.abs(values), -1.0)"
_CONJUGATE = "turn = product(pose[:, 3:], against[:, 3:] * [1.0, -1.0, -1.0, -1.0])"
_SHORTER = "turn = np.where(turn[:, :1] < 0.0, -turn, turn)"
_AXIS = "axis = np.divide(turn[:, 1:], sine, out=np.zeros_like(turn[:, 1:]), where=sine > _STILL)"

EQUIVALENT: Mapping[str, Mapping[Key, str]] = {
    "agent.safety": {
        ("", _TABLE, _TABLE.replace("+ 1", "+ 2")): "one flag more than the three that are looked up can make",
    },
    "agent.loop": {
        ("_law", _PART, _PART.replace("1.0", "2.0")): "all of it is the law's, as with one",
        ("_law", "if life is not None and part < 1.0:", "if True and part < 1.0:"): _WITH_A_SESSION,
        ("_of_object", _LEARNS, _LEARNS.replace(" or ", " and ")): _BOTH,
        ("_of_object", _LEARNS, _LEARNS.replace("adaptation is None", "False")): _BOTH,
        ("_of_object", _LEARNS, _LEARNS.replace("estimate is None", "False")): _BOTH,
        ("step", _BRAKES, _BRAKES.replace("if damped", "if True")): _WHILE_IT_BRAKES,
        ("step", _BRAKES, _BRAKES.replace("0.0", "1.0")): _WHILE_IT_BRAKES,
        ("step", _ALONE_IN, _ALONE_IN.replace("session is not None", "True")): _WITH_A_SESSION,
        ("step", _LIMITED, _LIMITED.replace("session is not None", "True")): _WITH_A_SESSION,
        ("step", _OFF, _OFF.replace("session is not None", "True")): _WITH_A_SESSION,
    },
    "agent.standing": {
        (
            "wait_here",
            "return memory._replace(shift=between(pose[:3], pose[3:], *agent.start))",
            "return memory._replace(shift=between(pose[:4], pose[3:], *agent.start))",
        ): "of a position three numbers are read",
    },
    "agent.cycles": {
        (
            "Cycles.gap_s",
            "passed_ns = 0 if self._begun_ns is None else now_ns - self._begun_ns",
            "passed_ns = 1 if self._begun_ns is None else now_ns - self._begun_ns",
        ): "no gap is as short as a nanosecond",
    },
    "agent.runner": {
        ("Runner._act", "if self._marks:", "if True:"): _SAVES_A_CALL,
        ("Runner._go_blind", "if self._marks:", "if True:"): _SAVES_A_CALL,
        ("Runner._cycle", "if happened:", "if True:"): "saves a call: nothing changes without an event (test_runner)",
        (
            "Runner._started",
            "counts = zero_ns != ticks.zero_ns and (session is None or session.counts(zero_ns, deadline_ns))",
            "counts = True and (session is None or session.counts(zero_ns, deadline_ns))",
        ): "the same start gives the same phase",
    },
    "agent.sight": {
        (
            "Sight.plan",
            "if bus is not Bus.RECOVER or arm is None:",
            "if bus is not Bus.RECOVER or False:",
        ): "nobody is brought back by a driver that cannot; said for the type checker",
    },
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
        ("EffectCheck.check", "return None", "pass"): _NONE,
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
        (
            "DynamixelDriver.disable",
            "if self._port.is_open:",
            "if True:",
        ): "a closed port refuses what is written to it, and that is suppressed",
    },
    "drivers.dynamixel.running": {
        ("Running.again", _TAKES_ON, _TAKES_ON.replace("made.grip is not None", "True")): _SAME_GRIPPER,
        ("Running.again", _TAKES_ON, _TAKES_ON.replace("self.grip is not None", "True")): _SAME_GRIPPER,
        ("Running.again", _TAKES_ON, _TAKES_ON.replace(" and ", " or ")): _SAME_GRIPPER,
        ("Running.__init__", "self._wire_free_ns = 0", "pass"): _SET_BY_A_QUESTION,
        ("Running.__init__", "self._wire_free_ns = 0", "self._wire_free_ns = 1"): _SET_BY_A_QUESTION,
        (
            "Running.write",
            "sent = [0.0] * len(tau_Nm)",
            "sent = [1.0] * len(tau_Nm)",
        ): "each joint has a writer, which fills its place",
    },
    "agent.telemetry.ring.file": {
        ("_create_as", _OPENS, _OPENS.replace("416", "832")): _FCHMOD,
        ("_create_as", _OPENS, _OPENS.replace("416", "208")): _FCHMOD,
        ("_create_as", "raise AssertionError('nobody else knows this file')", "pass"): "an assertion",
        ("_is_file", "return False", "pass"): "None is no file either",
        (
            "_is_unfinished",
            "if len(head) < SLOTS_OFFSET or head[:8] != MAGIC:",
            "if len(head) < SLOTS_OFFSET or False:",
        ): "somebody's own file has been refused before",
        ("map_file", _MAPPED, _MAPPED.replace("else 0", "else 1")): "MAP_SHARED is 1",
    },
    "agent.telemetry.ring.reader": {
        ("RingReader.close", "if self._fd < 0:", "if self._fd <= 0:"): _STANDARD_INPUT,
        ("RingReader.close", "if self._fd < 0:", "if self._fd < 1:"): _STANDARD_INPUT,
        ("RingReader.close", "self._fd = -1", "self._fd = -2"): "both are no descriptor",
        (
            "RingReader._copy",
            _INTACT,
            _INTACT.replace(" & ", " | "),
        ): "saves checksums: the index is in them, so a copy of another row fails there",
    },
    "agent.telemetry.ring.writer": {
        ("RingWriter.wait_for_space", _HAS_SPACE, "if False:"): _NO_CLOCK,
        ("RingWriter.wait_for_space", _HAS_SPACE, _HAS_SPACE.replace(" - ", " + ")): _NO_CLOCK,
        ("RingWriter.wait_for_space", "return", "pass"): _NO_CLOCK,
        ("RingWriter.wait_for_space", "time.sleep(_POLL_S)", "pass"): "saves computing while it waits",
        ("RingWriter.close", "if self._fd < 0:", "if self._fd <= 0:"): _STANDARD_INPUT,
        ("RingWriter.close", "if self._fd < 0:", "if self._fd < 1:"): _STANDARD_INPUT,
        ("RingWriter.close", "self._fd = -1", "self._fd = -2"): "both are no descriptor",
        ("_aligned_row", _ROOM, _ROOM.replace("16", "17")): "seven bytes to spare are enough",
        ("_aligned_row", _ROOM, _ROOM.replace("16", "15")): "seven bytes to spare are enough",
        (
            "_aligned_row",
            "offset = (4 - memory.ctypes.data) % 8",
            "offset = (4 + memory.ctypes.data) % 8",
        ): "memory begins at a multiple of 16",
        ("", "_POLL_S: Final = 0.0002", "_POLL_S: Final = 0.0004"): "how often a writer in lockstep looks again",
        (
            "",
            "LOCKSTEP_TIMEOUT_S: Final = 30.0",
            "LOCKSTEP_TIMEOUT_S: Final = 60.0",
        ): "how long a run in simulated time waits for telemetry that hangs",
    },
    "agent.telemetry.ring.texts": {
        ("TextReader.read_new", _TEXTS, _TEXTS.replace("64", "128")): "how many at a time; the loop takes all",
        ("TextReader.read_new", _TEXTS, _TEXTS.replace("64", "32")): "how many at a time; the loop takes all",
    },
    "agent.replay.same": {
        ("_of_member", _COMMON, _COMMON.replace("unique=True", "unique=False")): "numbers of rows are unique",
        ("_pairs", _ENCODED, _ENCODED.replace("-1", "-2")): "numpy takes any number below zero",
        ("_bytes_differ", _BYTES, _BYTES.replace("-1", "-2")): "numpy takes any number below zero",
    },
    "agent.view.camera": {
        ("camera_for", _MIDDLE, _MIDDLE.replace("+ back", "- back")): "seen from behind up is up",
        ("_front", _ALONE, _ALONE.replace("<", "<=")): "no two arms are exactly so near",
        ("_front", _ALONE, _ALONE.replace("1e", "2e")): "no two arms are so near",
        ("_front", _ACROSS, _ACROSS.replace("<", "<=")): "either axis does for a slanting up",
        ("_front", _ACROSS, _ACROSS.replace("0.0, 1.0]", "0.0, 2.0]")): "its length does not matter",
        ("_front", _ACROSS, _ACROSS.replace("[1.0", "[2.0")): "its length does not matter",
        ("_front", _ACROSS, _ACROSS.replace("[1.0, 0.0, 0.0", "[1.0, 0.0, 1.0")): "up is along z there",
    },
    "agent.view.curves": {
        ("thinned", _SIZED, _SIZED.replace("-1.0", "-2.0")): "any size below zero is below all others",
    },
    "agent.view.player": {
        ("Player.__init__", _NO_ROW, _NO_ROW.replace("-1", "1")): "the first picture is that of row 0",
        ("Player.__init__", _NO_ROW, _NO_ROW.replace("-1", "-2")): "any number below zero is no row",
        ("Player.__init__", "self._told = -1", "self._told = -2"): "any number below zero is no row",
        ("Player._build", _STEP, _STEP.replace("6)", "7)")): "the step of a slider has few decimals",
        ("Player._build", _STEP, _STEP.replace("6)", "5)")): "the step of a slider has few decimals",
        ("Player.want", "self._wish.notify()", "pass"): "the picture comes a thirtieth of a second later",
        ("Player.step", _IDLE, "if False:"): "it looks more often",
        ("Player.step", _IDLE, "if True:"): "the picture comes a thirtieth of a second later",
        ("Player.step", _IDLE, _IDLE.replace("is None", "is not None")): "the picture comes a thirtieth later",
        ("Player.step", "self._wish.wait(1.0 / PLAY_HZ)", "pass"): "it looks more often",
        ("Player.step", "self._wish.wait(1.0 / PLAY_HZ)", "self._wish.wait(2.0 / PLAY_HZ)"): "it looks less often",
        ("Player.step", _PLAYING, _PLAYING.replace("t is None", "True")): "a wish sets the start of playing, too",
        ("Player.step", "if self._started is started:", "if True:"): "differs when a pause comes within microseconds",
        ("Player.step", _AT_END, _AT_END.replace("started is not None", "True")): "what does not play stops as well",
        ("Player._follow", "if row < 0:", "if False:"): "so for microseconds, while errors are enlarged",
        ("Player._follow", "return", "pass"): "so for microseconds, while errors are enlarged",
        ("Player._follow", _TELLS, _TELLS.replace("row != self._told", "True")): "the same text is told again",
    },
    "agent.view.pose": {
        ("", "_STILL: Final = 1e-12", "_STILL: Final = 2e-12"): "no half angle of a log is between the two",
        ("exaggerated", _CONJUGATE, _CONJUGATE.replace(" * ", " / ")): "1 and −1 are their own inverses",
        ("exaggerated", _SHORTER, _SHORTER.replace("<", "<=")): "half a turn is the same in both senses",
        ("exaggerated", _AXIS, _AXIS.replace(">", ">=")): "no half angle is exactly so small",
    },
    "agent.operator.socket": {
        (
            "_remove_unserved",
            "path.unlink(missing_ok=True)",
            "path.unlink(missing_ok=False)",
        ): "differs when somebody removes the socket between the question and the removal",
        ("ControlSocket._no_start", "return None", "pass"): _NONE,
        ("ControlSocket.poll", "if self._clients:", "if True:"): "saves the making of empty lists",
    },
}


def why_equivalent(mutant: Mutant) -> str:
    """The reason, or nothing."""
    return EQUIVALENT.get(mutant.module, {}).get(mutant.key, "")


def unused_entries(module: str, mutants: Sequence[Mutant]) -> list[str]:
    """Entries that are no change to the module any more."""
    keys = {mutant.key for mutant in mutants}
    return [f"equivalent.py names no change: {key}" for key in EQUIVALENT.get(module, {}) if key not in keys]
