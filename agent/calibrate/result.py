"""What a calibration found, and the text of the new cell and its arm files.

Joint zeros go into the arm files as whole encoder steps (`zero_tick`); base and grasp are fitted again to the zeros as
they stand there.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pinocchio as pin
import tomli_w

from agent.calibrate.chain import CalibrateError, Chain, Link, Matrix, as_exact, as_loose_as_told
from agent.calibrate.poses import Poses
from agent.calibrate.propose import Proposal, propose
from agent.calibrate.solve import Solution, disagreement, explained, rms, solve
from agent.config.cell import Arm, Cell
from agent.config.edit import Change, apply, lines_of, newline_of
from agent.config.reality import reality_of
from agent.config.schema.arm import LAST_TICK
from agent.config.schema.reality import ArmReality, Reality
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import Vector

SEEN_BELOW: Final = 0.5  # of the prior's standard deviation is left
KNOWN: Final = 1e-12
GRID_TIMES: Final = 2.0  # the encoders' grid leaves once as much; readings have noise beside it, zeros whole steps


class Outcome(enum.StrEnum):
    """How well a parameter is known."""

    MEASURED = "measured"
    UNSEEN = "not seen by itself"
    GIVEN = "taken as exact"


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter of one arm; m or rad."""

    arm: str
    name: str
    value: float  # as written
    sigma: float  # standard error of that: of the fit, and what whole encoder steps have moved it by
    prior: float
    outcome: Outcome


@dataclass(frozen=True)
class Calibrated:
    """Everything a log says of the placements and zeros of its cell."""

    cell: Cell
    chain: Chain
    poses: Poses
    solution: Solution
    written: Vector  # (p,) with zeros of whole encoder steps
    before: tuple[Vector, Vector]  # disagreement of each pose, m and rad
    after: tuple[Vector, Vector]
    proposals: tuple[Proposal, ...]
    explained: tuple[float, float]  # m and rad of disagreement that the cell's own [tolerance] has, poses held out
    grid: tuple[float, float]  # the same of arms that are exact, of the encoders' grid alone

    @property
    def judged(self) -> tuple[float, float, float, float]:
        """Disagreement of the poses held out, rms: before and after, m and rad."""
        held = self.poses.held_out
        before, after = (tuple(rms(v[held]) for v in of) for of in (self.before, self.after))
        return before[0], after[0], before[1], after[1]

    @property
    def better(self) -> bool:
        """Whether the poses held out agree better than before."""
        before_m, after_m, before_rad, after_rad = self.judged
        return after_m < before_m and after_rad <= max(before_rad, 1.1 * TICK_RAD)

    @property
    def settled(self) -> bool:
        """Whether the file agrees already: its disagreement may be of readings alone, and the fit mended nothing."""
        before_m, _, before_rad, _ = self.judged
        most_m, most_rad = self.readings
        return not self.better and before_m <= most_m and before_rad <= most_rad

    @property
    def readings(self) -> tuple[float, float]:
        """Disagreement, m and rad, that may be of the readings alone."""
        m, rad = self.grid
        return GRID_TIMES * m, GRID_TIMES * rad

    @property
    def left(self) -> tuple[float, float]:
        """Disagreement after of most poses held out, m and rad: half have less, and a grasp may slip in some."""
        held = self.poses.held_out
        return float(np.median(self.after[0][held])), float(np.median(self.after[1][held]))

    @property
    def agrees(self) -> bool:
        """Whether arms that are merely within the cell's own [tolerance] would disagree as much, or more."""
        return all(left <= most for left, most in zip(self.left, self.explained, strict=True))

    @property
    def free(self) -> int:
        """Parameters that are not taken as exact."""
        return int((self.chain.scale > KNOWN).sum())

    def estimates(self) -> list[Estimate]:
        """Each parameter, base before grasp before zeros, arm after arm."""
        all_of = (self.written, self.solution.sigma, self.written - self.solution.x)
        found, parts = [], [self.chain.parts(v) for v in all_of]
        for link, value, sigma, moved in zip(self.chain.links, *parts, strict=True):
            for i, name in enumerate(_names(link)):
                left = sigma[i] / link.scale[i] if link.scale[i] > KNOWN else 0.0
                outcome = Outcome.UNSEEN if left > SEEN_BELOW else Outcome.MEASURED
                outcome = outcome if link.scale[i] > KNOWN else Outcome.GIVEN
                of = (float(value[i]), math.hypot(sigma[i], moved[i]), float(link.scale[i]))
                found.append(Estimate(link.arm.name, name, *of, outcome))
        return found


def calibrated(cell: Cell, chain: Chain, poses: Poses) -> Calibrated:
    """Calibrate a cell from the poses that are not held out."""
    used = poses.some(~poses.held_out)
    solution = solve(chain, used)
    zeros = np.full(chain.size, np.nan)
    for link, own, x in zip(chain.links, chain.parts(zeros), chain.parts(solution.x), strict=True):
        own[link.zeros] = TICK_RAD * np.rint(x[link.zeros] / TICK_RAD)
    written = solve(chain, used, zeros).x
    before, after = (disagreement(chain, x, poses.q) for x in (np.zeros(chain.size), written))
    proposals = tuple(propose(chain, solution, used))
    held, nothing = poses.some(poses.held_out), np.zeros(chain.size)
    told, grid = (explained(of, nothing, held) for of in (as_loose_as_told(cell), as_exact(chain)))
    return Calibrated(cell, chain, poses, solution, written, before, after, proposals, told, grid)


def arm_toml(arm: Arm, zeros_rad: Vector, urdf: str | None = None) -> str:
    """The arm's own file with its zeros moved, and with the name that its URDF has from now on, if given.

    Raises CalibrateError for a zero beyond the scale, and EditError.
    """
    changes: list[Change] = []
    if urdf is not None and urdf != arm.file.urdf:
        changes.append(Change("", "urdf", f'"{urdf}"  # was {arm.file.urdf}, the name of another arm\'s'))
    for servo, zero in zip(arm.servos, zeros_rad.tolist(), strict=True):
        tick = servo.zero_tick + round(zero / TICK_RAD)
        if not 0 <= tick <= LAST_TICK:
            raise CalibrateError(
                f"zero of joint {servo.name} of arm {arm.name}", found=f"tick {tick}", expected=f"0 to {LAST_TICK}",
                remedy="mount its horn nearer to the middle",
            )  # fmt: skip
        if tick != servo.zero_tick:
            changes.append(Change("joints", "zero_tick", f"{tick}  # calibrated, was {servo.zero_tick}", servo.name))
    text = arm.toml.decode()
    return apply(text, changes) if changes else text


def cell_toml(result: Calibrated, source: str, arm_files: Sequence[str]) -> str:
    """The cell's text with bases and grasps moved and each arm's file named.  Raises EditError."""
    changes: list[Change] = []
    for link, x, file in zip(result.chain.links, result.chain.parts(result.written), arm_files, strict=True):
        changes += _changes(link, x, file, source)
    text = _of_the_run_alone(result.cell.toml.decode())
    edited = apply(text, changes)
    rest = remaining(result)
    if rest is None:
        return edited
    more = "\n\n" + tomli_w.dumps({"simulation": {"reality": rest.model_dump(exclude_none=True)}})
    return edited.rstrip("\r\n") + more.replace("\n", newline_of(edited))


def remaining(result: Calibrated) -> Reality | None:
    """Reality of a simulated cell against the calibrated one: the same truth, other beliefs; None where there is none.

    A cell with errors drawn from a seed has each of them by value from then on.
    """
    real = reality_of(result.cell)
    if real is None:
        return None
    arms = {}
    for link, x in zip(result.chain.links, result.chain.parts(result.written), strict=True):
        arms[link.arm.name] = _remaining(link, x, real.arms.get(link.arm.name, ArmReality()))
    return real.model_copy(update={"seed": None, "arms": {**real.arms, **arms}})


def _remaining(link: Link, x: Vector, real: ArmReality) -> ArmReality:
    base, grasp, zeros = link.base @ x[: link.m], link.grasp @ x[link.m : 2 * link.m], x[link.zeros]
    true = np.array(real.zeros_rad) if real.zeros_rad else np.zeros(link.arm.n)
    left = [_less(np.array((*m, *rad)), v) for m, rad, v in (
        (real.base_m, real.base_rad, base), (real.grasp_m, real.grasp_rad, grasp))]  # fmt: skip
    return real.model_copy(
        update={
            "base_m": tuple(left[0][:3]), "base_rad": tuple(left[0][3:]), "grasp_m": tuple(left[1][:3]),
            "grasp_rad": tuple(left[1][3:]), "zeros_rad": tuple((true - zeros).tolist()),
        }
    )  # fmt: skip


def _less(true: Vector, believed: Vector) -> list[float]:
    turn = pin.log3(pin.exp3(true[3:]) @ pin.exp3(believed[3:]).T)
    return [*(true[:3] - believed[:3]).tolist(), *turn.tolist()]


def _changes(link: Link, x: Vector, file: str, source: str) -> Iterator[Change]:
    base, grasp = link.placements(x)
    for key, T in (("world_base", base), ("object_ee", grasp)):
        old = link.arm.T_world_base if key == "world_base" else link.arm.T_object_ee
        away_m, turned = np.linalg.norm(T.translation - old.translation), pin.log3(T.rotation @ old.rotation.T)
        how = f"  # {source}: moved by {1e3 * away_m:.2f} mm"
        yield Change("arms", f"p_{key}_m", _list(T.translation, 7) + how, link.arm.name)
        turn = f"  # {source}: turned by {1e3 * np.linalg.norm(turned):.2f} mrad"
        yield Change("arms", f"quat_{key}", _list(_quat(T), 15) + turn, link.arm.name)
    yield Change("arms", "arm_file", f'"{file}"', link.arm.name)


def _of_the_run_alone(text: str) -> str:
    """The text without what was of the run: [floating], and [simulation.reality], of which the rest follows anew."""
    kept, dropping = [], False
    for line in lines_of(text):
        if line.lstrip().startswith("["):
            header = line.lstrip().lstrip("[").lstrip()
            dropping = header.startswith(("simulation.reality", "floating]"))
        if not dropping:
            kept.append(line)
    return "".join(kept)


def _names(link: Link) -> Iterator[str]:
    for what, columns in (("base", link.base), ("grasp", link.grasp)):
        for column in columns.T:
            i = int(np.argmax(np.abs(column)))
            yield f"{what} {'xyz'[i % 3]}" if i < 3 else f"{what} about {'xyz'[i % 3]}"
    yield from (f"zero of {servo.name}" for servo in link.arm.servos)


def _list(values: Matrix | Sequence[float], digits: int) -> str:
    return "[" + ", ".join(repr(round(float(v), digits) + 0.0) for v in values) + "]"


def _quat(T: pin.SE3) -> list[float]:
    x, y, z, w = (float(v) for v in pin.Quaternion(T.rotation).normalized().coeffs())
    return [math.copysign(1.0, w) * v for v in (w, x, y, z)]


def summary(result: Calibrated) -> dict[str, Any]:
    """All of it for a machine."""
    before_m, after_m, before_rad, after_rad = result.judged
    return {
        "schema": 1,
        "cell": result.cell.file.name,
        "fingerprint": result.cell.fingerprint,
        "poses": len(result.poses.t),
        "held_out": int(result.poses.held_out.sum()),
        "disagreement_before": {"rms_m": before_m, "rms_rad": before_rad},
        "disagreement_after": {"rms_m": after_m, "rms_rad": after_rad},
        "disagreement_of_tolerance": {"rms_m": result.explained[0], "rms_rad": result.explained[1]},
        "parameters": result.free,
        "observed": result.solution.observed,
        "spread": result.solution.spread,
        "better": result.better,
        "settled": result.settled,
        "estimates": [
            {"arm": e.arm, "name": e.name, "value": e.value, "sigma": e.sigma, "prior": e.prior, "outcome": e.outcome}
            for e in result.estimates()
        ],
        "proposals": [{"what": p.what, "factor": p.factor} for p in result.proposals],
    }
