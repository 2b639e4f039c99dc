"""`make hil`: rehearsals beside the fully simulated cell, a line each, and exit code 1 where a bound is missed.

Error and internal force rms over 10 s; the real driver on emulated servos of lone arms, virtual time.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

import configs
from agent.config.cell import Cell, load_cell
from agent.faults.looped import PHASE_NS
from agent.modes import Mode
from sim_backend.wire.faults import Fault, FaultKind
from tests.support.hil.rehearsal import Rehearsal

CELLS = ("paper_real", "two_wx200", "three_wx250s", "four_wx250s")
DURATION_S, FROM_S, FAULT_S = 12.0, 2.0, 2.0
FORCE_FLOOR_N = 0.1
APART_M = 1e-3
MORE_S = 0.1  # of a hold
FALL_M = 0.1  # beyond which nobody holds the object any more
IN_A_CYCLE_S = 0.003  # of the plant, so that its arm goes limp with the next one, as in the rehearsal
HALF_A_CYCLE_NS = 2_500_000
HOLD_S, MOVES_M, TURNS_RAD_PER_S = 0.025, 5e-3, 0.5  # once the plant is gone
TOUCH_N, TOUCH_S = 5.0, 0.3
PARTED_M, TOGETHER_M = 30e-3, 2e-3
EVERY_S = 1.6  # a touch
BEARABLE = 0.95  # of a joint's torque bound, from which on no law stands against a touch
SOFT = "simulation.grasp={stiffness_N_per_m=2e3,stiffness_Nm_per_rad=20.0}"


class Table:
    """What was found; `missed` counts bounds that do not hold."""

    def __init__(self) -> None:
        self.missed = 0

    def run(self, cell: str, arms: list[str], changes: tuple[str, ...] = (), **how: Any) -> tuple[float, float]:
        """Figures of one run."""
        loop = (f"hil.arms={json.dumps(arms)}",) if arms else ()
        changed = [f"duration_s={DURATION_S}", *loop, *changes]
        return Rehearsal(load_cell(configs.CELLS_DIR / f"{cell}.toml", changed), **how).figures(FROM_S)

    def line(self, what: str, found: tuple[float, float], full: tuple[float, float], *, within: float | None) -> None:
        """One line; within: share of deviation both ways, None: at most 1.5 times."""
        ratios = (found[0] / full[0], max(found[1], FORCE_FLOOR_N) / max(full[1], FORCE_FLOOR_N))
        good = max(ratios) <= 1.5 if within is None else all(abs(ratio - 1.0) <= within for ratio in ratios)
        self.missed += not good
        sys.stdout.write(
            f"{what:44} {found[0]:6.3f} mm {found[1]:6.3f} N   simulated {full[0]:6.3f} mm {full[1]:6.3f} N   "
            f"x {ratios[0]:.2f} x {ratios[1]:.2f}  {'' if good else 'MISSED'}\n"
        )
        sys.stdout.flush()

    def cell(self, name: str) -> None:
        """One cell: one arm, all arms, lost commands, delay, an arm that is otherwise, soft grasps."""
        arms = [arm.name for arm in load_cell(configs.CELLS_DIR / f"{name}.toml").arms]
        first, n = arms[0], load_cell(configs.CELLS_DIR / f"{name}.toml").arms[0].n
        full = self.run(name, [])
        self.line(f"{name}, {first}", self.run(name, [first]), full, within=None)
        self.line(f"{name}, all arms", self.run(name, arms), full, within=None)
        self.line(f"{name}, 10 % of commands lost", self.run(name, [first], lost=0.1), full, within=None)
        late = self.run(name, [first], ("hil.extra_cycles=1.0",), older_cycles=1)
        self.line(f"{name}, one more cycle", late, full, within=None)
        off = (f"simulation.reality.arms.{first}={{friction=1.5,masses=1.1,torque_constant={json.dumps([0.9] * n)}}}",)
        self.line(f"{name}, {first} otherwise", self.run(name, [first], off), self.run(name, [], off), within=0.15)
        self.line(f"{name}, soft grasps", self.run(name, [first], (SOFT,)), self.run(name, [], (SOFT,)), within=None)

    def loss(self, name: str) -> None:
        """The first arm without power, unplugged, its agent killed: beside the simulated cell with the same limp arm.

        Until all others hold, and a tenth of a second more; and to the end, where they can carry the object.  Where
        they cannot it falls, and how far two simulated falls are apart that differ by half a cycle is told beside it.
        """
        first = load_cell(configs.CELLS_DIR / f"{name}.toml").arms[0].name
        power = [Fault(kind=FaultKind.POWER_LOSS, arm=first, start_s=FAULT_S)]
        self.lost(name, "power off", lambda cell: Rehearsal(cell, faults=power))
        for what, happening in (
            ("unplugged", lambda run: setattr(run.ports[first], "lost", True)),
            ("agent killed", lambda run: run.kill(first)),
        ):
            self.lost(name, what, lambda cell, do=happening: Rehearsal(cell, happenings={FAULT_S: do}))

    def lost(self, name: str, what: str, make: Callable[[Cell], Rehearsal]) -> None:
        """One line of it."""
        cell = load_cell(configs.CELLS_DIR / f"{name}.toml", ["duration_s=4.0"])
        first = cell.arms[0].name
        real = make(load_cell(configs.CELLS_DIR / f"{name}.toml", ["duration_s=4.0", f'hil.arms=["{first}"]']))
        at_s = ((real.plant.seats[first].limp_ns or 0) - (real.zero_ns or 0)) * 1e-9
        sims = [
            Rehearsal(
                cell,
                phase_ns=phase_ns,
                happenings={
                    FAULT_S: lambda run: setattr(run.sims[first], "silent", True),
                    at_s + IN_A_CYCLE_S: lambda run: run.plant.seats[first].switch_off(),
                },
            )
            for phase_ns in (PHASE_NS, PHASE_NS + HALF_A_CYCLE_NS)
        ]
        held_s = max(_holds_s(run) for run in (real, sims[0]))
        until, _ = _apart(real, sims[0], held_s + MORE_S)
        apart, moved = _apart(real, sims[0])
        good = until <= APART_M and (moved > FALL_M or apart <= APART_M)
        self.tell(
            f"{name}, {what}",
            f"limp after {at_s - FAULT_S:.3f} s, all hold after {held_s - FAULT_S:.3f} s: object {until * 1e3:.2f} mm "
            f"from the simulated one until then, {apart * 1e3:.2f} mm to the end, which moves {moved * 1e3:.1f} mm and "
            f"is {_apart(sims[1], sims[0])[0] * 1e3:.2f} mm from itself half a cycle later",
            good=good,
        )

    def plant_killed(self, name: str) -> None:
        """The plant's process: how soon every real arm holds, how far and how fast the first one moves from then on."""
        motion: list[tuple[Any, float]] = []
        first = load_cell(configs.CELLS_DIR / f"{name}.toml").arms[0].name

        def kill(run: Rehearsal) -> None:
            run.plant.killed = True
            run.watch(
                lambda _, lone: motion.append((lone.end_effector().translation.copy(), np.abs(lone.dq).max())), first
            )

        changes = ["duration_s=3.0", f'hil.arms=["{first}"]']
        run = Rehearsal(load_cell(configs.CELLS_DIR / f"{name}.toml", changes), happenings={FAULT_S: kill})
        rows = run.arms[first].rows
        after_s = float(rows["t"][rows["mode"] == Mode.HOLD][0]) - FAULT_S
        way_m = max(float(np.linalg.norm(place - motion[0][0])) for place, _ in motion)
        speed = max(speed for _, speed in motion)
        self.tell(
            f"{name}, plant killed",
            f"HOLD after {after_s * 1e3:.0f} ms, the real arm moves {way_m * 1e3:.2f} mm, {speed:.2f} rad/s at most",
            good=after_s <= HOLD_S and way_m <= MOVES_M and speed <= TURNS_RAD_PER_S,
        )

    def touched(self, name: str, arms: list[str]) -> None:
        """5 N for 0.3 s on the first arm to all sides, one after the other; where its joints can give that torque."""
        first, going = arms[0], load_cell(configs.CELLS_DIR / f"{name}.toml")
        apart: list[tuple[float, float]] = []
        begun: list[float] = []
        beyond: list[Any] = []

        def begin(run: Rehearsal, at_s: float, push: Any) -> None:
            if not begun:
                run.watch(lambda t, _: apart.append((t, run.apart_m(first))), first)
            if _share_of_torque(run, first, push) > BEARABLE:
                beyond.append(push)
                return
            begun.append(at_s)
            run.lone(first).touch(np.append(TOUCH_N * push, np.zeros(3)))

        def end(run: Rehearsal) -> None:
            run.lone(first).touch(np.zeros(6))

        happenings: dict[float, Any] = {}
        for k, push in enumerate(_sides(going)):
            at_s = FAULT_S + k * EVERY_S
            happenings[at_s] = lambda run, at_s=at_s, push=push: begin(run, at_s, push)
            happenings[at_s + TOUCH_S] = end
        changes = [f"duration_s={max(happenings) + EVERY_S}", f"hil.arms={json.dumps(arms)}"]
        run = Rehearsal(load_cell(configs.CELLS_DIR / f"{name}.toml", changes), happenings=happenings)
        ended = {arm.summary.mode: arm.summary.reason for arm in run.arms.values() if arm.summary is not None}
        most = max(gap for _, gap in apart)
        later = max(gap for t, gap in apart if any(1.0 < t - TOUCH_S - at < EVERY_S - TOUCH_S for at in begun))
        reasons = " ".join(reason for reason in ended.values() if reason)
        self.tell(
            f"{name}, {TOUCH_N:g} N for {TOUCH_S:g} s, {len(arms)} in the loop",
            f"{len(begun)} touches, {'none noticed' if set(ended) == {Mode.TRACK} else reasons}; {most * 1e3:.1f} mm "
            f"apart at most, {later * 1e3:.2f} mm from a second after them on"
            + (f"; beyond the arm's torque: {', '.join(_named(push) for push in beyond)}" if beyond else ""),
            good=set(ended) == {Mode.TRACK} and most <= PARTED_M and later <= TOGETHER_M,
        )
        for push in beyond:
            self.beyond(name, arms, push)

    def beyond(self, name: str, arms: list[str], push: Any) -> None:
        """The same where a joint cannot give as much: the arm yields, and all go on or all hold."""
        first, apart = arms[0], list[tuple[float, float]]()

        def begin(run: Rehearsal) -> None:
            run.watch(lambda t, _: apart.append((t, run.apart_m(first))), first)
            run.lone(first).touch(np.append(TOUCH_N * push, np.zeros(3)))

        changes = [f"duration_s={FAULT_S + TOUCH_S + EVERY_S}", f"hil.arms={json.dumps(arms)}"]
        happenings = {FAULT_S: begin, FAULT_S + TOUCH_S: lambda run: run.lone(first).touch(np.zeros(6))}
        run = Rehearsal(load_cell(configs.CELLS_DIR / f"{name}.toml", changes), happenings=happenings)
        modes = {arm.summary.mode for arm in run.arms.values() if arm.summary is not None}
        later = max(gap for t, gap in apart if t > FAULT_S + TOUCH_S + 1.0)
        ended = " and ".join(sorted(mode.name for mode in modes))
        self.tell(
            f"{name}, {TOUCH_N:g} N to {_named(push)}, beyond its torque",
            f"all {ended}; {max(gap for _, gap in apart) * 1e3:.0f} mm apart at most, {later * 1e3:.2f} mm from a "
            "second after it on",
            good=len(modes) == 1 and modes <= {Mode.TRACK, Mode.HOLD} and later <= TOGETHER_M,
        )

    def tell(self, what: str, found: str, *, good: bool) -> None:
        """One line that is no ratio."""
        self.missed += not good
        sys.stdout.write(f"{what:44} {found}{'' if good else '  MISSED'}\n")
        sys.stdout.flush()


def _sides(cell: Cell) -> list[Any]:
    """Directions (3,) in which the cell's arms can move: along the axes, to both sides, and two oblique ones."""
    P = cell.model(cell.arms[0]).task_basis[:, :3]
    sides = [sign * axis for axis in np.eye(3) if np.linalg.norm(P @ axis) > 0.5 for sign in (1.0, -1.0)]
    oblique = [a + b for a, b in ((sides[0], sides[2]), (sides[1], sides[-2]))]
    return [*sides, *(side / np.linalg.norm(side) for side in oblique)]


def _named(push: Any) -> str:
    return f"({', '.join(f'{x + 0.0:.1f}' for x in push)})"


def _share_of_torque(run: Rehearsal, arm: str, push: Any) -> float:
    """Of its bound, what a joint of the arm must give to stand against 5 N of this direction: the largest."""
    own, bridge = run.cell.arm(arm), run.arms[arm].bridge
    assert bridge is not None
    model = run.cell.model(own)
    J = (model.task_basis.T @ model.jacobian(run.lone(arm).q))[:3]
    bound = own.tau_stall_Nm * run.cell.file.safety.tau_max_fraction_of_stall
    return float((np.abs(bridge.sent - TOUCH_N * J.T @ push) / bound).max())


def _holds_s(run: Rehearsal) -> float:
    """From the common start until the last of the other arms holds."""
    others = [arm.rows for name, arm in run.arms.items() if name != run.cell.arms[0].name]
    return max(float(rows["t"][rows["mode"] == Mode.HOLD][0]) for rows in others)


def _apart(one: Rehearsal, other: Rehearsal, until_s: float = np.inf) -> tuple[float, float]:
    """Largest distance (m) of the objects of two runs from the start on, and the largest way of the second."""
    (t, p), (t2, p2) = (_path(run) for run in (one, other))
    then = t2[(t2 > 0.0) & (t2 < min(t[-1], t2[-1], until_s))]
    first, second = (
        np.array([np.interp(then, *xy) for xy in ((a, b[:, k]) for k in range(3))]).T for a, b in ((t, p), (t2, p2))
    )
    return float(np.linalg.norm(first - second, axis=1).max()), float(np.linalg.norm(second - second[0], axis=1).max())


def _path(run: Rehearsal) -> tuple[Any, Any]:
    t = np.array([(stamp_ns - (run.zero_ns or 0)) * 1e-9 for stamp_ns, _ in run.plant.seen])
    return t, np.array([seen.p_object for _, seen in run.plant.seen])


if __name__ == "__main__":
    table = Table()
    for cell in sys.argv[1:] or CELLS:
        table.cell(cell)
        table.loss(cell)
        table.plant_killed(cell)
        names = [arm.name for arm in load_cell(configs.CELLS_DIR / f"{cell}.toml").arms]
        table.touched(cell, names[:1])
        table.touched(cell, names)
    if not sys.argv[1:]:
        full = table.run("paper_adaptive", [])
        table.line("paper_adaptive, left", table.run("paper_adaptive", ["left"]), full, within=None)
    sys.exit(table.missed > 0)
