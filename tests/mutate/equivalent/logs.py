"""Of the ring, its files and texts, and of the replay and the report of logs."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_OPENS = "fd = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 416)"
_FCHMOD = "the next line sets the mode, before anything is in the file"
_HAS_SPACE = "if self.written - self._words[ACKNOWLEDGED_WORD] < enough:"
_LOOKS = "how often somebody is asked while it waits"
_NO_CLOCK = "the short way, without asking the clock; the loop behind it ends as soon"
_TEXTS = "block = self._ring.read_new(64)"
_ROOM = "memory = np.zeros(dtype.itemsize + 16, np.uint8)"
_STANDARD_INPUT = "descriptor 0 is a process's standard input"
_COMMON = "_, i, j = np.intersect1d(a['sequence'], b['sequence'], assume_unique=True, return_indices=True)"
_ENCODED = "rows = [np.ascontiguousarray(part.messages()).reshape(-1).view(layout.dtype) for part in (one, other)]"
_BYTES = "x, y = (np.ascontiguousarray(rows[name]).view(np.uint8).reshape(len(rows), -1) for rows in (a, b))"

_UNKNOWN = "known = np.where(np.abs(t) < NO_TIME_S, t, -NO_TIME_S)"
_BLOCK = "messages = np.ascontiguousarray(part.messages()).reshape(-1).view(layout.dtype)"

_LOOPED = "def __init__(self, agent: Agent, config_id: int, readable: Readable, *, in_the_loop: bool=False) -> None:"
_ZERO = "return cls(begins, tuple((zero.most_common(1)[0][0] for zero in zeros)))"
_TIMES = (
    "return [(stamp - (own if waits or span < 0 else self.zeros_ns[span])) * 1e-09 "
    "for stamp, own, waits, span in zip(stamps, zeros, ready, spans, strict=True)]"
)

_ALIGNED = "aligned = [quat * np.sign(np.sum(quat * first, axis=1, keepdims=True)) for _, quat in poses.values()]"
_BETWEEN = "return rows[(rows['t'] > begin_s) & (rows['t'] < end_s)]"
_SIZE = "return ring_file.make_header(row_format, slots=slots, name='', joints=(), created_ns=0).file_bytes"

_HEIR_SLOT = "head = _SLOT_HEAD.pack(index + 1, zlib.crc32(row, index & 4294967295))"
_WAITS = "def wait_for_space(self, timeout_s: float=0.0) -> None:"

LOGS: Entries = {
    "agent.telemetry.ring.heir": {
        (
            "RingHeir.finish",
            "self._put_word(FINISHED_WORD, 1)",
            "self._put_word(FINISHED_WORD, 2)",
        ): "any number says so",
        ("RingHeir.close", "if self._fd < 0:", "if self._fd <= 0:"): _STANDARD_INPUT,
        ("RingHeir.close", "if self._fd < 0:", "if self._fd < 1:"): _STANDARD_INPUT,
        ("RingHeir.close", "self._fd = -1", "self._fd = -2"): "no descriptor either",
        ("RingHeir._put", _HEIR_SLOT, _HEIR_SLOT.replace("4294967295", "2147483647")): "nobody writes 2^31 rows",
        ("RingHeir.wait_for_space", _WAITS, _WAITS.replace("0.0", "1.0")): "nothing waits",
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
    },
    "agent.telemetry.ring.reader": {
        (
            "RingReader.read_last",
            "following = self.read_at(behind, end - behind)",
            "following = self.read_at(behind, end + behind)",
        ): "rows that nobody has written yet are not intact",
        (
            "RingReader._copy",
            "some = min(count - done, header.slots - place)",
            "some = min(count + done, header.slots - place)",
        ): "no more is read than there is room for",
        ("RingReader.close", "if self._fd < 0:", "if self._fd <= 0:"): _STANDARD_INPUT,
        ("RingReader.close", "if self._fd < 0:", "if self._fd < 1:"): _STANDARD_INPUT,
        ("RingReader.close", "self._fd = -1", "self._fd = -2"): "both are no descriptor",
    },
    "agent.telemetry.ring.writer": {
        ("file_bytes", _SIZE, _SIZE.replace("created_ns=0", "created_ns=1")): "a size has no date",
        ("RingWriter.wait_for_space", _HAS_SPACE, "if False:"): _NO_CLOCK,
        ("RingWriter.wait_for_space", _HAS_SPACE, _HAS_SPACE.replace(" - ", " + ")): _NO_CLOCK,
        ("RingWriter.wait_for_space", "return", "pass"): _NO_CLOCK,
        ("RingWriter.wait_for_space", "time.sleep(_POLL_S)", "pass"): "saves computing while it waits",
        ("RingWriter.wait_for_space", "if now >= look:", "if True:"): _LOOKS,
        ("RingWriter.wait_for_space", "if now >= look:", "if now > look:"): _LOOKS,
        ("RingWriter.wait_for_space", "look = now + _LOOK_S", "pass"): _LOOKS,
        ("RingWriter.wait_for_space", "look = now + _LOOK_S", "look = now - _LOOK_S"): _LOOKS,
        ("", "_LOOK_S: Final = 0.02", "_LOOK_S: Final = 0.04"): _LOOKS,
        ("RingWriter.close", "if self._fd < 0:", "if self._fd <= 0:"): _STANDARD_INPUT,
        ("RingWriter.close", "if self._fd < 0:", "if self._fd < 1:"): _STANDARD_INPUT,
        ("RingWriter.close", "self._fd = -1", "self._fd = -2"): "both are no descriptor",
        ("aligned_row", _ROOM, _ROOM.replace("16", "17")): "seven bytes to spare are enough",
        ("aligned_row", _ROOM, _ROOM.replace("16", "15")): "seven bytes to spare are enough",
        (
            "aligned_row",
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
    "agent.report.found_together": {
        (
            "found_together",
            "end_s = min(tracked, default=-math.inf)",
            "end_s = min(tracked, default=math.inf)",
        ): "a run without arms has no pair of them",
        (
            "found_together",
            "if not begin_s >= run.info.transient_s - half_s:",
            "if not begin_s > run.info.transient_s - half_s:",
        ): "no tick is half a period beside one",
        ("_between", _BETWEEN, _BETWEEN.replace("> begin_s", ">= begin_s")): "no tick is half a period beside one",
        ("_between", _BETWEEN, _BETWEEN.replace("< end_s", "<= end_s")): "no tick is half a period beside one",
    },
    "agent.replay.chain": {
        ("Chain.pass_row", "if marks:", "if True:"): "saves a call: joining no flag changes nothing",
    },
    "agent.replay.grasps": {
        ("", "NO_TIME_S = 1000000000.0", "NO_TIME_S = 2000000000.0"): "no run lasts as long",
        ("_nanoseconds", _UNKNOWN, _UNKNOWN.replace("<", "<=")): "no run lasts just as long",
        ("_mean", _ALIGNED, _ALIGNED.replace("quat * np.sign", "quat / np.sign")): "1 and −1 are their own inverses",
    },
    "agent.replay.rows": {
        ("blocks", _BLOCK, _BLOCK.replace("-1", "-2")): "numpy takes any number below zero",
        ("blocks", "if layout.dtype == AGENT_STATE.dtype:", "if False:"): "saves the copying of field after field",
    },
    "agent.replay.verify": {
        ("_Verifier.__init__", _LOOPED, _LOOPED.replace("False", "True")): "whoever makes one says it",
        (
            "_Clock.of",
            "spans = [slice(k, end) for k, end in pairwise(edges) if not waits[k]]",
            "spans = [slice(k, end) for k, end in pairwise(edges) if True]",
        ): "saves the zeros of waits, whose rows count by their own",
        ("_Clock.of", _ZERO, _ZERO.replace("(1)", "(2)")): "the first of the two most common ones is the most common",
        ("_Clock.times", _TIMES, _TIMES.replace("span < 0", "False")): "what comes before all spans waits",
        (
            "_spans",
            "if spans and spans[-1][1] == begin:",
            "if False:",
        ): "saves comparing what is beside one another alone",
    },
    "agent.replay.same": {
        ("_of_member", _COMMON, _COMMON.replace("unique=True", "unique=False")): "numbers of rows are unique",
        ("_pairs", _ENCODED, _ENCODED.replace("-1", "-2")): "numpy takes any number below zero",
        ("_bytes_differ", _BYTES, _BYTES.replace("-1", "-2")): "numpy takes any number below zero",
    },
}
