"""Of the loop: the tick and its bounds, what a cycle sees and does, the operator's socket."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_JOINED = "happened = happened | found if found else happened"
_SAVES_A_CALL = "saves a call: joining no flag changes nothing"
_BRAKES = "brake = brake_per_s(agent.period_s) if damped else 0.0"
_WHILE_IT_BRAKES = "read only while the arm brakes"
_WITH_A_SESSION = "asked for twice, for the type checker: whoever is alone has a session"
_PART = "part = 1.0 if life is None else phases.handing_over(life, mode, memory)"
_PULLS = "if mode is _HOLD and memory.braced.force_N:"
_LEARNS = "if adaptation is None or estimate is None:"
_BOTH = "who learns has an estimate; said for the type checker"
_NONE = "a function without a result returns None"
_OFF = "if off_m <= AT_LIMIT * self._start_m and off_rad <= AT_LIMIT * self._start_rad:"
_JUST = "of exactly so much, a rounding beyond the limit, either is right"
_PEEK = "return bool(client.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT))"
_NOBODY_YET = "it is not asked for before somebody has been agreed with"
_INSTANT = "return request.verb is Verb.START or (request.verb is Verb.LOWER and request.start_utc_ns > 0)"
_TABLE = "_FLAGS = tuple(map(Flag, range((_NOT_FINITE | _SATURATED | _RATE_LIMITED) + 1)))"

_HOLD = "hold = tuple(tail[:7]) if any(tail[3:7]) else None"
_LOAD = "load = self.upper.arm.reshape(-1, len(self.upper.arm) // ARM_PARAMETERS_PER_JOINT)[-2:].sum(axis=0)"
_START = "object.__setattr__(self, 'start', Estimate(*divided(_together(self.start))))"
_LEAKS = "if self.leak_per_s > 0.0:"
_HELD = "held = inside.tobytes() != theta.tobytes() and _outside(theta, self._alarm, self._upper)"
_BODIES = "bodies = inside[:BODY_PARAMETERS * (n + 1)].reshape(-1, BODY_PARAMETERS)"
_WHOLE = "if whole is not None and whole is body.base and (len(whole) == len(arm) + len(body)):"
_MANY = "STARVED_PERIODS, MANY = (3.5, 4)"
_ANY_BELOW_ZERO = "numpy takes any number below zero"
_FORGETS_NOTHING = "at a rate of zero it forgets nothing"
_PUT_TOGETHER = "put together again it is the same"
_PARTS = "nobody has parts of one array that are not all of it"
_FLAGGED = "found = self._reason or f'{outcome.flags.name} {explained(self._agent, outcome)}'.rstrip()"

_FELT = "if below.max() <= 0.0 and above.max() <= 0.0:"
_NO_WALL = "saves an inverse: in no wall the sum is zero"
_ROOM = "if abs(there + wanted) > bound and wanted:"
_HAS_ROOM = "what has room is not made smaller"
_ALONG = "along = sign if tau_rest >= 0.0 else -sign"
_TURNED = "if size + along * bound >= 0.0:"
_SAME = "self._same = [0] * len(bounds.joints)"
_ASKED = "self._asked_rad = [0.0] * len(bounds.joints)"
_FIRST = "the first reading is another than none, and begins both"
_EVERY = "every so many ticks, whichever way they are counted"
_HELD_POSE = "p, quat = (memory.hold[:3], memory.hold[3:])"
_AT_Q = "k = model.evaluate(q, 0.0 * q)"
_AT_HOLD = "held = model.evaluate(q_hold, 0.0 * q_hold)"
_NO_SPEED = "nothing that depends on a speed is read of it"
_NO_SHIFT = "if shift is NO_SHIFT or shift == NO_SHIFT:"
_HALF = "k = 2.0 if size < _SMALL_ANGLE else 2.0 * math.atan2(size, w) / size"
_SMALL = "if angle < _SMALL_ANGLE:"
_ALMOST_NONE = "so small an angle is its sine, and its cosine is one"
_DEAD = "if not size > dead_zone:"
_NO_MORE = "adds nothing where no more than one period has passed"
_PAIRS = "_pairs: tuple[tuple[float, float], ...] = field(init=False, repr=False)"
_NO_INTERNAL = "return NO_WRENCH if wanted is None else shift_to_ee(k, internal)"

_NEW_ROWS = "if written > self.kept_end:"
_NOTHING_NEW = "of no new row none is read"
_HOW_OFTEN = "how often somebody is told meanwhile; no test measures time"
_COUNTS = "self._seen_s = self._slow_s = 0.0"
_AT_LAST = "return Event.ARRIVED if lies or seconds >= SINK_MAX_S else Event.NONE"
_TASK = "e_v_task = e_v if len(P) == 6 else P.T.dot(P.dot(e_v)).tolist()"
_IDENTITY = "saves a product with the identity"
_NO_NUMBER = "if info != 0 or not math.isfinite(inverse[0, 0]):"
_SPREADS = "what is no number spreads to every entry of the inverse"
_ROWS = "_IDENTITY = tuple((np.eye(n, order='F') for n in range(7)))"
_TWISTS = "twists = np.zeros((2, 6))"
_PARALLEL = "parallel = np.abs(np.abs(axes.dot(normal)) - 1.0) < 1e-06"
_ALMOST_ZERO = "normal = np.where(np.abs(normal) < 1e-09, 0.0, normal)"
_LARGEST = "if normal[np.argmax(np.abs(normal))] < 0.0:"
_ARRAYS = "_arrays: tuple[Matrix, ...] = field(init=False, repr=False, compare=False)"
_RANK = "if not sigma[-1] > SINGULAR * sigma[0]:"
_SHIFTED = "shifted: list[bool] = np.any(np.abs(slipped) > LEAST_SLIP, axis=1).tolist()"
_ROUNDING = "what slips does so by far more than rounding"

_ARRIVES = "saves working the same out again: to the bit the same"
_GIVES = "saves what changes nothing where no pad gives way"
_TURNING = "turning = max(map(abs, (*v[:J].tolist(), *v[J + 3:].tolist(), 1e-09)))"
_LEFT = "self._left = max(1, math.floor(min(self.spec.relinearise_s, MAX_TURN_RAD / turning) / h + 1e-09))"
_FAST = "if not float(self._v.dot(self._v)) < FASTEST ** 2:"
_SAVES = "saves adding zeros"
_ACTED = "acted = mean if geared is None else dq - (h[:J] - ahead) * a[:J]"
_PUSHES = "tau_dry, push, geared = (self._tau_dry, self._push.copy() if self._pushed else None, copy.copy(self._gears))"
_OF_PADS = "pulls = pads.K * (self._phi - pads.slipped) + pads.C * self._openings.G.dot(v).reshape(-1, 6)"

CONTROL: Entries = {
    "sim_backend.physics.calendar": {
        (
            "_whole",
            "return near if abs(substeps - near) < WHOLE else substeps",
            "return near if abs(substeps - near) <= WHOLE else substeps",
        ): "no quotient of times is off by just so much",
    },
    "sim_backend.physics.gears": {
        (
            "Gears.meet",
            "for _ in range(len(dq) + 1):",
            "for _ in range(len(dq) + 2):",
        ): "no more rounds than teeth and one",
    },
    "sim_backend.physics.openings": {
        ("", "LEAST_SLIP: Final = 1e-12", "LEAST_SLIP: Final = 2e-12"): _ROUNDING,
        ("Openings.measure", _SHIFTED, _SHIFTED.replace(">", ">=")): _ROUNDING,
    },
    "sim_backend.physics.plant": {
        ("Plant._integrate", "if servos.has_friction:", "if True:"): _SAVES,
        ("Plant._integrate", "if self._pushed:", "if True:"): _SAVES,
        ("Plant.__init__", "self._pushed = False", "self._pushed = True"): _SAVES,
        (
            "Plant._integrate",
            _ACTED,
            _ACTED.replace("geared is None", "False"),
        ): "without gears `ahead` is half a substep",
        ("Plant.snapshot", _PUSHES, _PUSHES.replace("if self._pushed", "if True")): _SAVES,
    },
    "sim_backend.physics.soft": {
        ("SoftPlant.__init__", "self._behind = False", "self._behind = True"): _ARRIVES,
        ("SoftPlant._arrive", "if not self._behind:", "if False:"): _ARRIVES,
        ("SoftPlant._arrive", "return", "pass"): _ARRIVES,
        ("SoftPlant._arrive", "self._behind = False", "pass"): _ARRIVES,
        ("SoftPlant._arrive", "self._behind = False", "self._behind = True"): _ARRIVES,
        ("SoftPlant._slip", "if not gave.any():", "if False:"): _GIVES,
        ("SoftPlant._slip", "return", "pass"): _GIVES,
        ("SoftPlant._integrate", "if self._pads.slips:", "if True:"): _GIVES,
        (
            "SoftPlant._linearise",
            _TURNING,
            _TURNING.replace("1e-09", "2e-09"),
        ): "a cell that stands so still turns less",
        ("SoftPlant._linearise", _LEFT, _LEFT.replace("1e-09)", "2e-09)")): "no quotient is off by just so much",
        ("SoftPlant._integrate", _FAST, _FAST.replace("<", "<=")): "no motion is just so fast",
        (
            "SoftPlant.observe",
            _OF_PADS,
            _OF_PADS.replace("-1, 6", "-2, 6"),
        ): "numpy finds out the rest for any negative number",
    },
    "agent.control.adaptive": {
        ("torque", _TASK, _TASK.replace("len(P) == 6", "False")): _IDENTITY,
        ("torque", _TASK, _TASK.replace("6", "7")): _IDENTITY,
        ("torque", _TASK, _TASK.replace("6", "5")): _IDENTITY,
    },
    "agent.control.estimator": {
        ("Observer", _ARRAYS, _ARRAYS.replace("compare=False", "compare=True")): "arrays of the same numbers are equal",
    },
    "agent.control.inverse": {
        ("pseudo_inverse", _RANK, "if True:"): "saves what numpy's wrappers cost: to the bit the same",
        ("_invert", _NO_NUMBER, _NO_NUMBER.replace("0, 0]", "1, 0]")): _SPREADS,
        ("_invert", _NO_NUMBER, _NO_NUMBER.replace("0, 0]", "0, 1]")): _SPREADS,
        ("", _ROWS, _ROWS.replace("7", "8")): "one identity more than a task space has rows",
    },
    "agent.control.models": {
        ("Scratch.__init__", _TWISTS, _TWISTS.replace("2, 6", "3, 6")): "room for one row more, which nobody is given",
        ("ArmModel.evaluate", "if self.task_is_identity:", "if False:"): _IDENTITY,
        ("_task_space", _PARALLEL, _PARALLEL.replace("<", "<=")): "no angle between two axes gives just that number",
        ("_task_space", _ALMOST_ZERO, _ALMOST_ZERO.replace("<", "<=")): "no rounding gives just that number",
        ("_task_space", _ALMOST_ZERO, _ALMOST_ZERO.replace("1e-09", "2e-09")): "so small a part changes no row",
        ("_task_space", _LARGEST, _LARGEST.replace("<", "<=")): "the largest part of a direction is not zero",
    },
    "agent.safety": {
        ("", _TABLE, _TABLE.replace("+ 1", "+ 2")): "one flag more than the three that are looked up can make",
    },
    "agent.missed": {
        ("", _MANY, _MANY.replace("4", "5")): "a name for more than three: it is compared with itself alone",
    },
    "agent.loop": {
        (
            "step",
            "speed = felt(dq, state.dq) if damped else dq",
            "speed = felt(dq, state.dq) if True else dq",
        ): _WHILE_IT_BRAKES,
        ("_law", _PART, _PART.replace("1.0", "2.0")): "all of it is the law's, as with one",
        ("_law", "if life is not None and part < 1.0:", "if True and part < 1.0:"): _WITH_A_SESSION,
        ("_law", _PULLS, _PULLS.replace("memory.braced.force_N", "True")): "saves adding a pull of nothing",
        ("_of_object", _LEARNS, _LEARNS.replace(" or ", " and ")): _BOTH,
        ("_of_object", _LEARNS, _LEARNS.replace("adaptation is None", "False")): _BOTH,
        ("_of_object", _LEARNS, _LEARNS.replace("estimate is None", "False")): _BOTH,
        ("step", _BRAKES, _BRAKES.replace("if damped", "if True")): _WHILE_IT_BRAKES,
        ("step", _BRAKES, _BRAKES.replace("0.0", "1.0")): _WHILE_IT_BRAKES,
    },
    "agent.control.alignment": {
        ("shifted", _NO_SHIFT, _NO_SHIFT.replace("shift is NO_SHIFT", "False")): "saves a comparison",
        ("between", "if w < 0.0:", "if w <= 0.0:"): "half a turn to either side is one attitude",
        ("between", _HALF, _HALF.replace("<", "<=")): _ALMOST_NONE,
        ("_quaternion", _SMALL, _SMALL.replace("<", "<=")): _ALMOST_NONE,
        ("", "_SMALL_ANGLE = 1e-09", "_SMALL_ANGLE = 2e-09"): _ALMOST_NONE,
        ("_towards", _DEAD, _DEAD.replace(">", ">=")): "at the edge of the dead zone it moves by nothing",
        ("_towards", "if length <= bound:", "if length < bound:"): "at its bound it is scaled by one",
    },
    "agent.control.floating": {
        ("walls", _FELT, _FELT.replace("below.max() <= 0.0", "below.max() < 0.0")): _NO_WALL,
        ("walls", _FELT, _FELT.replace("above.max() <= 0.0", "above.max() < 0.0")): _NO_WALL,
        ("walls", _FELT, "if False:"): _NO_WALL,
        ("walls", "return np.zeros_like(q)", "pass"): _NO_WALL,
        ("room", _ROOM, _ROOM.replace(">", ">=")): _HAS_ROOM,
        ("room", _ROOM, _ROOM.replace("abs(there + wanted) > bound", "True")): _HAS_ROOM,
    },
    "agent.control.friction": {
        ("solved", _ALONG, _ALONG.replace(">=", ">")): "beside no other torque both ways are one",
        ("solved", _TURNED, _TURNED.replace(">=", ">")): "at no torque both ways are one",
        ("Friction", _PAIRS, _PAIRS.replace("False)", "True)")): "how it is printed",
    },
    "agent.control.law": {
        ("reference", "if model.task_is_identity:", "if False:"): "saves a product with the identity",
        ("add_wrenches", _NO_INTERNAL, _NO_INTERNAL.replace("wanted is None", "False")): "saves a shift of nothing",
    },
    "agent.guard.guarded": {
        ("Guarded.poll", "self._cycles += 1", "self._cycles -= 1"): _EVERY,
    },
    "agent.host.process_handle": {
        ("", "KILL_LOOK_MS = 5", "KILL_LOOK_MS = 4"): _HOW_OFTEN,
        ("", "KILL_LOOK_MS = 5", "KILL_LOOK_MS = 6"): _HOW_OFTEN,
        (
            "ProcessHandle.ended",
            "return _is_readable(self._fd, 0)",
            "return _is_readable(self._fd, 1)",
        ): "finds the same, a bit later",
    },
    "agent.process.hearing": {
        ("Hearing._first", "return None", "pass"): "the end of the function",
    },
    "agent.guard.watched": {
        ("Watched.hangs", _NEW_ROWS, "if True:"): _NOTHING_NEW,
        ("Watched.hangs", _NEW_ROWS, _NEW_ROWS.replace(">", ">=")): _NOTHING_NEW,
        ("Watched.inherit", "if self.text_ring.damage:", "if True:"): "a whole file is mended to what it is",
    },
    "agent.process.float_loop": {
        ("Ending.__init__", _COUNTS, _COUNTS.replace("0.0", "1.0")): "read in SINK, and each mode begins them anew",
        ("Ending.events", _AT_LAST, _AT_LAST.replace(">=", ">")): "no whole nanoseconds times 1e-9 are just 30.0",
    },
    "agent.monitors.body": {
        ("", "AT_LIMIT = 1.0 + 1e-09", "AT_LIMIT = 1.0 + 2e-09"): "of a rounding more",
        ("Start.check", _OFF, _OFF.replace("off_m <=", "off_m <")): _JUST,
        ("Start.check", _OFF, _OFF.replace("off_rad <=", "off_rad <")): _JUST,
        ("Limited.check", "if now != ticks[place]:", "if True:"): "saves a write of what is there",
        ("Load.check", "self._tick += 1", "self._tick -= 1"): _EVERY,
    },
    "agent.monitors.joints": {
        ("Frozen.__init__", _SAME, _SAME.replace("[0]", "[1]")): _FIRST,
        ("Frozen.__init__", _ASKED, _ASKED.replace("[0.0]", "[1.0]")): _FIRST,
    },
    "agent.monitors.watch": {
        ("Watch.after", "self._tick += 1", "self._tick -= 1"): _EVERY,
    },
    "agent.phases": {
        ("lowering", _HELD_POSE, _HELD_POSE.replace("[:3]", "[:4]")): "of a place three numbers are read",
    },
    "agent.control.joint_hold": {
        ("weight", _AT_Q, _AT_Q.replace("0.0 * q", "0.0 / q")): _NO_SPEED,
        ("weight", _AT_Q, _AT_Q.replace("0.0 * q", "1.0 * q")): _NO_SPEED,
        ("torque", _AT_HOLD, _AT_HOLD.replace("0.0 * q", "0.0 / q")): _NO_SPEED,
        ("torque", _AT_HOLD, _AT_HOLD.replace("0.0 * q", "1.0 * q")): _NO_SPEED,
    },
    "agent.control.residual": {
        ("Residual.advance", "if periods > 1:", "if periods >= 1:"): _NO_MORE,
        ("Residual.advance", "if periods > 1:", "if True:"): _NO_MORE,
    },
    "agent.control.adaptation": {
        ("Adaptation.__post_init__", _LOAD, _LOAD.replace("(-1", "(-2")): _ANY_BELOW_ZERO,
        ("Adaptation.__post_init__", _START, "pass"): _PUT_TOGETHER,
        ("Adaptation.advance", _LEAKS, "if True:"): _FORGETS_NOTHING,
        ("Adaptation.advance", _LEAKS, _LEAKS.replace(">", ">=")): _FORGETS_NOTHING,
        (
            "Adaptation.advance",
            _HELD,
            _HELD.replace("inside.tobytes() != theta.tobytes()", "True"),
        ): "what no bound changed is not outside",
        ("Adaptation.advance", _BODIES, _BODIES.replace("-1", "-2")): _ANY_BELOW_ZERO,
        ("Adaptation.advance", "if possible is not bodies:", "if True:"): "copies what is there already",
        ("_joined", _WHOLE, "if False:"): _PUT_TOGETHER,
        ("_joined", _WHOLE, _WHOLE.replace("whole is body.base", "True")): "nobody mixes parts of two estimates",
        ("_joined", _WHOLE, _WHOLE.replace("(len(whole) == len(arm) + len(body))", "True")): _PARTS,
        ("_joined", _WHOLE, _WHOLE.replace("is body", "is not body")): _PUT_TOGETHER,
        ("_joined", _WHOLE, _WHOLE.replace("==", "!=")): _PUT_TOGETHER,
        ("_joined", _WHOLE, _WHOLE.replace(" + ", " - ")): _PUT_TOGETHER,
        ("_joined", "return whole", "pass"): _PUT_TOGETHER,
    },
    "agent.control.memory": {
        ("restore", _HOLD, _HOLD.replace("[3:7]", "[2:7]")): "no pose without a quaternion has a height",
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
        (
            "Runner._act",
            _FLAGGED,
            _FLAGGED.replace("self._reason", "False"),
        ): "saves the making of a text that is not told",
        ("Runner._act", "if self._marks:", "if True:"): _SAVES_A_CALL,
        ("Runner._go_blind", "if self._marks:", "if True:"): _SAVES_A_CALL,
        ("Runner._cycle", _JOINED, _JOINED.replace("if found", "if True")): _SAVES_A_CALL,
        ("Runner._cycle", "if happened:", "if True:"): "saves a call: nothing changes without an event (test_runner)",
        (
            "Runner._started",
            "if zero_ns != ticks.zero_ns and (session is None or session.counts(zero_ns, deadline_ns)):",
            "if True and (session is None or session.counts(zero_ns, deadline_ns)):",
        ): "the same start gives the same phase",
    },
    "agent.sight": {
        (
            "Sight.plan",
            "if bus is not Bus.RECOVER or arm is None:",
            "if bus is not Bus.RECOVER or False:",
        ): "nobody is brought back by a driver that cannot; said for the type checker",
    },
    "agent.host.unix_socket": {
        ("", "WAIT_S = 5.0", "WAIT_S = 10.0"): "how long somebody is waited for, who never lets go",
        ("", "_LOOK_S = 0.01", "_LOOK_S = 0.02"): "how often it is looked",
        (
            "_alone_in",
            "if time.monotonic() >= deadline:",
            "if time.monotonic() > deadline:",
        ): "differs in the very nanosecond",
        ("_remove_unserved", "return False", "pass"): "None is not removed either",
        (
            "_remove_unserved",
            "path.unlink(missing_ok=True)",
            "path.unlink(missing_ok=False)",
        ): "differs when somebody removes the socket between the question and the removal",
    },
    "agent.operator.promise": {
        ("Promise.__init__", "self._until_ns = 0", "self._until_ns = 1"): _NOBODY_YET,
        ("Promise.__init__", "self._until_ns = 0", "pass"): _NOBODY_YET,
    },
    "agent.operator.socket": {
        ("ControlSocket._no_start", "return None", "pass"): _NONE,
        ("ControlSocket._not_agreed", "return None", "pass"): _NONE,
        ("_has_instant", _INSTANT, _INSTANT.replace("> 0", "> 1")): "no instant is one nanosecond after 1970",
        (
            "_waits",
            _PEEK,
            _PEEK.replace("1", "2"),
        ): "of what waits two bytes are looked at instead of one, and none is taken",
        ("_waits", "return False", "pass"): "None is as good as False to who asks whether",
        ("ControlSocket.poll", "if self._clients:", "if True:"): "saves the making of empty lists",
        ("ControlSocket.poll", "if self._asked.poll(0):", "if True:"): "saves a system call that finds nobody",
    },
}
