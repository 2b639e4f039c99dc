"""Of what is worked out before a run, of the eye that a guard has on its agent, and of what touches an arm."""

from __future__ import annotations

from tests.mutate.equivalent.entries import Entries

_LENGTH = "if abs(math.hypot(*map(float, words)) - 1.0) > _ROUNDED:"
_NORM = "norm = np.abs(A).sum(axis=-2).max(axis=-1, initial=1.0)"
_ONE = "A, B, one = (A / parts, B / parts, np.eye(A.shape[-1]))"
_FLAT = "flat = A.reshape(len(A), -1)"
_ON = "on = ~small & (off < 1.0)"
_LEFT = "w = np.concatenate([w, _internal(S, [-S_i @ (beyond * e.off) for S_i, e in zip(S, errors, strict=True)])], -1)"
_GIVEN = "return np.concatenate([-S @ off, errors.wrench], axis=1)"
_ENDS = "ends = np.cumsum([0, *(g.shape[1] for g in given)])"
_LINEAR = "found: NDArray[np.bool_] = np.linalg.norm(P[:, _FORCE], axis=1) > 0.5"
_PARTS = "_FORCE, _MOMENT = (slice(0, 3), slice(3, 6))"
_HELD = "block: NDArray[np.bool_] = np.arange(count) * BLOCKS // max(count, 1) % 4 == 2"
_AHEAD = "if np.abs(ahead).max() > AHEAD_MAX_RAD:"
_MOST = "NAMED_MAX: Final = 1000"
_BEFORE = "before = times[0]"
_FLOORS = "FLOORS: Final = Channels(0.5, 0.05, 0.3, 0.03)"
_BALLS = "bound, found = (self._balls(pairs) - slack, Nearest(math.inf, pairs[0], 0))"
_AT_PLACES = "bound, found = (self._balls(pairs), Nearest(math.inf, pairs[0], 0))"
_SHAPE = "geometry.addGeometryObject(pin.GeometryObject(str(i), 0, pin.SE3.Identity(), shape.geometry))"
_AT_FIRST = "found: list[float] = Way(self.shapes, self.R[:1], self.p[:1]).distances(pairs)[0].tolist()"
_STEP = "step = np.pad(self._steps, ((1, 1), (0, 0)))"
_AS_NEAR = "if bound[place, k] >= found.distance_m:"
_LOWER = "if low < found.distance_m:"
_ANY_IS_NEARER = "the first distance takes its place"
_FIRST_STAYS = "of two that are as near the first one stays"
_IN_ORDER = "how many are put in order first changes the time it takes"
_FIRST_LOOK = "the first look sets it"
_FIRST = "first = _last_fresh(rows) or 0"
_AWAY = "away_ns, period_ns = (clock.now_ns() - int(rows[-1]['stamp_ns']) if len(rows) else 0, schedule.period_ns)"
_GIVES = "gives_back = mode is Mode.RELEASE and agent.session is not None and (memory is not None)"
_KNOWN = "known = np.isfinite(tau_held) & ~(np.abs(tau_held - sent) <= SAME_NM)"
_CURRENT = "limit = model.register(GOAL_CURRENT).maximum or 0"
_PWM = "limit = model.register(GOAL_PWM).maximum or 0"
_GEARS = "no_load = self._no_load_count * math.tanh(dq / NO_LOAD_SMOOTH_RAD_PER_S) if self._no_load_count else 0.0"
_HAS_MOST = "every servo in that mode says the most of it"
_NO_GEARS = "zero times anything"
_NO_SIGN = "an error may have either sign, and the sizes of columns are given"
_A_TOUCH_SETS_IT = "a touch sets it as it begins, and nothing asks for it before"
_NOTHING_MORE = "where rounding alone is as large as one nothing is proved any more"
_ALONG = "return _sized(rng, most, v if normal is None else normal * float(normal @ v), R)"
_BOX = "found += [*_box(cell, each[0], instants), *_seen(cell, models, paths)]"
_OVER = "over: NDArray[np.bool_] = np.any(_sizes(self._channels @ w) > self._most, axis=(0, 1, 4))"
_ANGLE = "angle = 2.0 * np.arctan2(sine, np.abs(cosine)) * np.sign(cosine)"
_JITTER = "return real.model_copy(update={'delay_jitter_s': min(jitter_s, real.delay_s or 0.0)})"
_SENSE = "size, along = (np.abs(tau_rest), np.where(tau_rest >= 0.0, sign, -sign))"
_BOUND = "return np.where(size + along * bound >= 0.0, bound, turned)"
_ORDER = "return [fast, slow] if quick >= max(slow_N / limits.slow_N, slow_Nm / limits.slow_Nm) else [slow, fast]"
_UNLIKE = "return bool(np.linalg.norm((wrench - own) / limits) <= UNLIKE * np.linalg.norm(wrench / limits))"
_OTHER = "if float(np.linalg.norm(other[:3])) > other_N:"
_HANGS = "hangs = _cosine(first[3:], beyond, LEVER_M * math.hypot(*gravity)) >= LEAST_COSINE"
_MOMENT = "by_moment = float(np.linalg.norm(first[:3])) <= first_N and Cause.LIFT not in fits"
_ASLANT = "if hangs and (by_moment or _cosine(first[:3], gravity, 0.0) >= ASLANT):"
_FITS = "found = sorted((cause for cause, cosine in fits.items() if cosine >= LEAST_COSINE), key=lambda c: -fits[c])"
_REFUSED = "refused = float((off > most).any(axis=1).mean())"
_NO_WRENCH_IS_AT_IT = "no wrench that is measured is at the limit to the bit"
_SLOPE = "self._slope = np.where(np.isfinite(self._stall), self._stall, 0.0) / join('no_load_rad_s')"

CHECKS: Entries = {
    "agent.control.cause": {
        ("jumped", _UNLIKE, _UNLIKE.replace("<=", "<")): _NO_WRENCH_IS_AT_IT,
        ("parts", _ORDER, _ORDER.replace(">=", ">")): "of two that are as far above their limits either is the first",
        ("named", _OTHER, _OTHER.replace(">", ">=")): _NO_WRENCH_IS_AT_IT,
        ("named", _HANGS, _HANGS.replace(">=", ">")): _NO_WRENCH_IS_AT_IT,
        ("named", _MOMENT, _MOMENT.replace("<=", "<")): _NO_WRENCH_IS_AT_IT,
        ("named", _ASLANT, _ASLANT.replace(">=", ">")): _NO_WRENCH_IS_AT_IT,
        ("causes", _FITS, _FITS.replace(">=", ">")): _NO_WRENCH_IS_AT_IT,
    },
    "agent.verify.start": {
        ("start", _REFUSED, _REFUSED.replace(">", ">=")): "no error that is drawn is as large as the limit to the bit",
    },
    "agent.calibrate.poses": {
        ("held_out", _HELD, _HELD.replace("max(count, 1)", "max(count, 2)")): "one pose is in the first block",
    },
    "agent.config.monitors": {
        (
            "speeds_of_motion",
            _AHEAD,
            _AHEAD.replace(">", ">="),
        ): "joints found are the same, from wherever they are sought",
        ("speeds_of_motion", _BEFORE, _BEFORE.replace("0", "1")): "at the first instant it goes times no speed",
        ("", _MOST, _MOST.replace("1000", "2000")): "a box that looks at more of them is as right",
    },
    "agent.config.noticing": {
        ("", _FLOORS, _FLOORS.replace("0.05", "0.1")): "what seven arms or fewer feel of a touch is more",
    },
    "agent.config.reality": {
        (
            "_turn",
            _ALONG,
            _ALONG.replace("normal * float", "normal / float"),
        ): "its size is drawn; its sense is the same",
        ("_jittering_within", _JITTER, _JITTER.replace("0.0", "False")): "the least of the two is no jitter",
    },
    "agent.verify.rubbing": {
        ("Rubbing.fed", _SENSE, _SENSE.replace(">=", ">")): "of no torque either sign is right",
        ("Rubbing.fed", _BOUND, _BOUND.replace(">=", ">")): "where both are zero they are equal",
    },
    "agent.guard.takeover": {
        ("go_on", _AWAY, _AWAY.replace("else 0,", "else 1,")): "a nanosecond is no time",
    },
    "agent.guard.resume": {
        ("", "ROWS = 64", "ROWS = 128"): "more rows behind a fresh one change nothing",
        ("beginning", _FIRST, _FIRST.replace("_last_fresh(rows)", "False")): "rows follow from each other",
        ("stood_in", _GIVES, _GIVES.replace("mode is Mode.RELEASE", "True")): "no other mode asks what is gripped",
        ("from_torque", _KNOWN, _KNOWN.replace("<=", "<")): "of exactly so much either is right",
    },
    "agent.monitors.gravity": {
        ("Gravity.check", "if self._count or self._bad:", "if True:"): "to begin again what has not begun",
    },
    "drivers.dynamixel.servo.torque": {
        ("CurrentDrive.__init__", _CURRENT, _CURRENT.replace("0", "1")): _HAS_MOST,
        ("CurrentDrive.__init__", _CURRENT, _CURRENT.replace("0", "False")): _HAS_MOST,
        ("PwmDrive.__init__", _PWM, _PWM.replace("0", "1")): _HAS_MOST,
        ("PwmDrive.__init__", _PWM, _PWM.replace("0", "False")): _HAS_MOST,
        ("CurrentDrive.command", _GEARS, _GEARS.replace("if self._no_load_count", "if True")): _NO_GEARS,
        ("CurrentDrive.measured_Nm", _GEARS, _GEARS.replace("if self._no_load_count", "if True")): _NO_GEARS,
    },
    "agent.verify.collision.way": {
        ("", "AT_FIRST: Final = 512", "AT_FIRST: Final = 1024"): _IN_ORDER,
        ("", "AT_FIRST: Final = 512", "AT_FIRST: Final = 256"): _IN_ORDER,
        ("Way.nearest", _BALLS, _BALLS.replace("0))", "1))")): _ANY_IS_NEARER,
        ("Way.least", _AT_PLACES, _AT_PLACES.replace("0))", "1))")): _ANY_IS_NEARER,
        ("Way.nearest", _AS_NEAR, _AS_NEAR.replace(">=", ">")): _FIRST_STAYS,
        ("Way.least", _AS_NEAR, _AS_NEAR.replace(">=", ">")): _FIRST_STAYS,
        ("Way.nearest", _LOWER, "if True:"): "what the other bound raises is no nearer than the nearest either",
        ("Way.nearest", _LOWER, _LOWER.replace("<", "<=")): _FIRST_STAYS,
        ("Way.distances", _SHAPE, _SHAPE.replace("0", "1")): "its place is given for each place of the way",
        ("Way.first", _AT_FIRST, _AT_FIRST.replace("R[:1]", "R[:2]")): "places count by their centres",
        ("Way._moved", _STEP, _STEP.replace("(0, 0)", "(0, 1)")): "no pair names a shape behind the last",
        ("Way._travel", "if pair not in self._travels:", "if True:"): "the same is worked out again",
    },
    "agent.guard.vigil": {
        ("Vigil", "first_ns: int = 0", "first_ns: int = 1"): "no stale_ns is as short",
        ("Vigil", "count: int = -1", "count: int = -2"): "no count is below zero",
        ("Vigil", "still_ns: int = 0", "still_ns: int = 1"): _FIRST_LOOK,
        ("Vigil", "looked_ns: int = 0", "looked_ns: int = 1"): _FIRST_LOOK,
        ("Vigil", "excused_until_ns: int = 0", "excused_until_ns: int = 1"): "no host looks in its first nanosecond",
    },
    "agent.verify.criterion.exponential": {
        ("", "TERMS: Final = 5", "TERMS: Final = 6"): "four terms more, all below rounding",
        ("exponential", _NORM, _NORM.replace("-2", "-1", 1)): "any norm of a matrix bounds what the polynomial lacks",
        (
            "exponential",
            _NORM,
            _NORM.replace("1.0", "2.0"),
        ): "doubled once more than it needs, the same but for rounding",
        ("exponential", _ONE, _ONE.replace("-1", "-2")): "matrices are square",
        ("exponential", "for k in range(2, TERMS):", "for k in range(1, TERMS):"): "the first power is worked out too",
        (
            "exponential",
            "for k in range(int(doublings.max(initial=0))):",
            "for k in range(int(doublings.max(initial=1))):",
        ): "nothing is doubled that has been doubled as often as it needs",
    },
    "agent.verify.criterion.power": {
        ("below", _ON, _ON.replace("<", "<=")): _NOTHING_MORE,
        ("below", _ON, _ON.replace("1.0", "2.0")): _NOTHING_MORE,
        ("below", "if not on.all():", "if True:"): "saves the copying of what is not thinned out",
        ("_norm", _FLAT, _FLAT.replace("-1", "-2")): "numpy takes any number below zero",
    },
    "agent.config.urdf_joints": {
        ("refuse_odd_joints", _LENGTH, _LENGTH.replace(">", ">=")): "no length is off by just so much",
    },
    "agent.verify.disagreement": {
        ("_at", _LEFT, _LEFT.replace("-S_i", "S_i")): _NO_SIGN,
        ("_wrenches", _GIVEN, _GIVEN.replace("-S", "S")): _NO_SIGN,
        ("_internal", _ENDS, _ENDS.replace("[0", "[1")): "a column of zeros more adds nothing to any size",
        ("_linear", _LINEAR, _LINEAR.replace(">", ">=")): "a row is of length one or of none",
        ("", _PARTS, _PARTS.replace("6", "7")): "a wrench has six numbers",
    },
    "sim_backend.physics.actuator": {
        (
            "Servos.__init__",
            _SLOPE,
            _SLOPE.replace("0.0", "1.0"),
        ): "what has no stall torque has no no-load speed either",
        ("Servos.command", "if self._limited:", "if True:"): "nothing asks for the bounds of what has none",
    },
    "sim_backend.hil.touch": {
        ("Touch.__init__", "self._lasted_s = 0.0", "pass"): _A_TOUCH_SETS_IT,
        ("Touch.__init__", "self._lasted_s = 0.0", "self._lasted_s = 1.0"): _A_TOUCH_SETS_IT,
        ("Touch.__init__", "self._quiet_s = 0.0", "self._quiet_s = 1.0"): _A_TOUCH_SETS_IT,
    },
    "agent.verify.ahead": {
        ("turned", _ANGLE, _ANGLE.replace("* np.sign", "/ np.sign")): "a sign is its own inverse",
    },
    "agent.verify.asked": {
        ("asked", _BOX, _BOX.replace("each[0]", "each[1]")): "the box is the same for all arms",
    },
    "agent.verify.felt": {
        ("Feeling.until_felt", _OVER, _OVER.replace("> self", ">= self")): "nothing is at its limit to the bit",
    },
}
