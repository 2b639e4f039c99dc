"""From base parameters to the figures of an arm file: which are good enough to replace, and why the rest are kept."""

from __future__ import annotations

import enum
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from agent.config.cell import Arm
from agent.config.edit import Change, apply
from agent.config.schema.arm import ArmFile, Provenance
from agent.control.regressor import BODY_PARAMETERS
from agent.identify.columns import described_parameters
from agent.identify.equations import Options
from agent.identify.fit import Fit
from agent.identify.friction import BREAKAWAY, BREAKAWAY_LOAD, CERTAIN, LOAD
from agent.identify.recording import Recording

DIGITS: Final = 4  # of a figure in the arm file


class Outcome(enum.StrEnum):
    """What becomes of a figure of the arm file."""

    REPLACED = "replaced"
    UNCERTAIN = "kept: too uncertain"
    NOT_POSITIVE = "kept: the estimate is not positive"


@dataclass(frozen=True, slots=True)
class FigureEstimate:
    """One figure of one joint."""

    joint: str
    key: str  # of the arm file
    value: float
    sigma: float | None  # standard error; None: the best of a few
    previous: float
    outcome: Outcome


@dataclass(frozen=True)
class Identified:
    """Everything one recording says about its arm."""

    recording: Recording
    options: Options
    fit: Fit
    figures: tuple[FigureEstimate, ...]

    def arm_toml(self, text: str) -> str:
        """The arm file `text` with the replaced figures; every other byte stays.  Raises EditError."""
        changes = [self._change(f) for f in self.figures if f.outcome is Outcome.REPLACED]
        changes += self._absent()
        edited = apply(text, changes) if changes else text
        ArmFile.model_validate(tomllib.loads(edited))
        return edited

    def summary(self) -> dict[str, Any]:
        """All figures and base parameters, for a machine."""
        fit, arm = self.fit, self.recording.arm
        own = slice(len(fit.base.kept))
        return {
            "arm": arm.name,
            "model": arm.entry.model,
            "cell": self.recording.cell.file.name,
            "fingerprint": self.recording.cell.fingerprint,
            "run": self.recording.day,
            "options": asdict(self.options),
            "condition": fit.condition,
            "joints": [
                {
                    "name": name,
                    "share_of_time_used": float(fit.used[j]),
                    "rms_torque_Nm": float(fit.torque[j]),
                    "rms_residual_Nm": float(fit.residual[j]),
                    "rms_residual_before_Nm": float(fit.residual_described[j]),
                }
                for j, name in enumerate(arm.entry.controlled)
            ],
            "friction_model": {"name": fit.choice.name, "reason": fit.choice.reason},
            "torque_scales": [
                {"joint": name, "value": float(v), "sigma": float(s) if np.isfinite(s) else None, "taken": float(t)}
                for name, v, s, t in zip(
                    arm.entry.controlled, fit.scales.value, fit.scales.sigma, fit.scales.taken, strict=True
                )
            ],
            "loop_delay": None if fit.delay is None else fit.delay._asdict(),
            "figures": [asdict(f) for f in self.figures],
            "base_parameters": [
                {"name": name, "unit": unit, "value": float(v), "sigma": float(s), "described": float(d)}
                for name, unit, v, s, d in zip(
                    fit.base.names, fit.base.units, fit.value[own], fit.sigma[own], fit.described[own], strict=True
                )
            ],
        }

    def _change(self, f: FigureEstimate) -> Change:
        spread = ", best of a few" if f.sigma is None else f", ± {f.sigma:.1g}"
        return self._measured(f.joint, f.key, f.value, spread)

    def _measured(self, joint: str, key: str, value: float, how: str) -> Change:
        number, source = float(f"{value:.{DIGITS}g}"), f"{self.recording.source}{how}"
        toml = f'{{ value = {number!r}, status = "{Provenance.MEASURED.value}", source = "{source}" }}'
        return Change("joints", key, toml, joint)

    def _absent(self) -> list[Change]:
        """Zeros for what the arm file has and the chosen model has not, where the model's Coulomb friction goes in."""
        replaced = {(f.joint, f.key) for f in self.figures if f.outcome is Outcome.REPLACED}
        return [
            self._measured(servo.name, key, 0.0, ", not seen")
            for servo in self.recording.arm.servos
            for key in (BREAKAWAY, LOAD, BREAKAWAY_LOAD)
            if (servo.name, "coulomb_Nm") in replaced
            and (servo.name, key) not in replaced
            and (figure := getattr(servo, key)) is not None
            and figure.value > 0.0
        ]


def identified(recording: Recording, options: Options, fit: Fit) -> Identified:
    """Figures of the arm file from a fit.

    The base parameter of a rotor holds inertia of the links too; that part is taken from the URDF.
    """
    arm, base = recording.arm, fit.base
    described = described_parameters(arm, recording.cell.model(arm))
    figures: list[FigureEstimate] = []
    for j, servo in enumerate(arm.servos):
        rotor = base.rotor(j)
        links = fit.described[rotor] - described[BODY_PARAMETERS * arm.n + j]
        for key, i, part in (
            ("rotor_inertia_kg_m2", rotor, links),
            ("coulomb_Nm", base.coulomb(j), 0.0),
            ("viscous_Nm_s_per_rad", base.viscous(j), 0.0),
        ):
            value, sigma = float(fit.value[i] - part), float(fit.sigma[i])
            previous = float(getattr(servo, key).value)
            figures.append(FigureEstimate(servo.name, key, value, sigma, previous, _outcome(value, sigma)))
    return Identified(recording, options, fit, (*figures, *_sticking(arm, fit)))


def _sticking(arm: Arm, fit: Fit) -> list[FigureEstimate]:
    """Figures of friction beside Coulomb and viscous, and how breakaway falls off, which is written where that is."""
    figures, own = [], slice(len(fit.base.kept), None)
    for (key, joint), value, sigma in zip(fit.sticking, fit.value[own].tolist(), fit.sigma[own].tolist(), strict=True):
        figures.append(_figure(arm, joint, key, value, sigma))
    shape = fit.choice.shape
    if shape is not None:
        falling = sorted({joint for key, joint in fit.sticking if key != LOAD})
        for j in falling:
            with_it = [f.outcome for f in figures if f.joint == arm.servos[j].name and f.key != LOAD]
            outcome = Outcome.REPLACED if Outcome.REPLACED in with_it else Outcome.UNCERTAIN
            for (key, value), sigma in zip(shape._asdict().items(), (fit.speed_sigma, None), strict=True):
                figures.append(replace(_figure(arm, j, key, value, sigma), outcome=outcome))
    return figures


def _figure(arm: Arm, joint: int, key: str, value: float, sigma: float | None) -> FigureEstimate:
    servo = arm.servos[joint]
    before = getattr(servo, key)
    return FigureEstimate(
        servo.name, key, value, sigma, 0.0 if before is None else before.value, _outcome(value, sigma)
    )


def gravity_rows(fit: Fit) -> Sequence[tuple[str, float, float, float]]:
    """Name, estimate, standard error and described value of each gravity parameter, kg·m."""
    rows = np.array([fit.value, fit.sigma, fit.described])
    return [(fit.base.names[i], *rows[:, i].tolist()) for i in fit.base.gravity()]


def _outcome(value: float, sigma: float | None) -> Outcome:
    if value <= 0.0:
        return Outcome.NOT_POSITIVE
    return Outcome.REPLACED if sigma is None or sigma <= CERTAIN * value else Outcome.UNCERTAIN
