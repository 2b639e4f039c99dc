"""Which friction a recording shows beside Coulomb and viscous: columns of the candidates, chosen by held-out data.

Every candidate is fitted on all of the training data but one block of time and judged on that block, in turn.  A
candidate with more parameters is taken when it predicts what it has not seen better, by more than chance.  The shape of
its breakaway is where the search for the best one begins (joint.py).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Vector

Matrix = NDArray[np.float64]

FOLDS: Final = 8
BETTER: Final = 0.02  # least improvement of the mean squared residual; friction that is not there gains up to 0.01
CERTAIN: Final = 0.25  # a figure with a larger standard error, relative to itself, is not taken over
ERRORS: Final = 2.0  # standard errors, over the blocks, that a difference is away from none


class Shape(NamedTuple):
    """How breakaway falls off with speed."""

    stribeck_rad_per_s: float
    stribeck_exponent: float


SHAPES: Final = tuple(Shape(*x) for x in itertools.product((0.15, 0.3, 0.6, 1.0, 1.5), (1.0, 2.0)))
BREAKAWAY, LOAD, BREAKAWAY_LOAD = "breakaway_Nm", "load_friction", "breakaway_load_friction"
CANDIDATES: Final = {  # by how many parameters they have
    "Coulomb and viscous": (),
    "+ breakaway that falls off with speed": (BREAKAWAY,),
    "+ load": (LOAD,),
    "+ breakaway, and load": (BREAKAWAY, LOAD),
    "+ breakaway and load that fall off with speed": (BREAKAWAY, BREAKAWAY_LOAD),
}


Term = tuple[str, int]  # a key of the arm file, of one joint


class Choice(NamedTuple):
    """A candidate, and why it was taken."""

    name: str
    keys: tuple[str, ...]  # of the arm file
    shape: Shape | None
    reason: str
    rivals: tuple[tuple[tuple[str, ...], Shape | None], ...] = ()  # keys and shape of others that predict as well


@dataclass(frozen=True)
class Columns:
    """Filtered columns of every joint, each (k, n): by key of the arm file, those with a shape by it too."""

    of: Mapping[tuple[str, Shape | None], Matrix]

    def matrix(self, key: str, shape: Shape | None) -> Matrix:
        """The column of that key (k, n)."""
        return self.of[key, None if key == LOAD else shape]

    def some(self, which: slice) -> Columns:
        """The same at some of the samples."""
        return Columns({name: column[which] for name, column in self.of.items()})


def raw_columns(
    dq: Matrix, tau: Matrix, smooth_rad_per_s: float, shapes: Sequence[Shape]
) -> Iterator[tuple[tuple[str, Shape | None], Matrix]]:
    """Columns before any filter, one after the other, from speed and torque of the motors (k, n)."""
    sign, size = np.tanh(dq / smooth_rad_per_s), np.abs(tau)
    yield (LOAD, None), sign * size
    for shape in shapes:
        left = np.exp(-((np.abs(dq) / shape.stribeck_rad_per_s) ** shape.stribeck_exponent))
        yield (BREAKAWAY, shape), sign * left
        yield (BREAKAWAY_LOAD, shape), sign * left * size


def with_friction(columns: Matrix, friction: Columns, shape: Shape | None, taken: Sequence[Term]) -> Matrix:
    """Columns (k, n, b) of a part with those of `taken`, (key, joint), behind them."""
    k, n, b = columns.shape
    joined = np.zeros((k, n, b + len(taken)))
    joined[:, :, :b] = columns
    for i, (key, joint) in enumerate(taken):
        joined[:, joint, b + i] = friction.matrix(key, shape)[:, joint]
    return joined


def choose(columns: Matrix, tau: Matrix, used: NDArray[np.bool_], friction: Columns, condition_max: float) -> Choice:
    """The candidate that predicts best what it has not seen; columns (k, n, b), tau and used (k, n)."""
    n = tau.shape[1]
    weight = _weights(columns, tau, used)
    best = Choice("Coulomb and viscous", (), None, "")
    best_scores, said = _scores(columns, tau, used, weight, condition_max), []
    if best_scores is None:
        return best._replace(reason="the motion tells too little apart")
    judged: list[tuple[tuple[str, ...], Shape | None, Vector]] = [((), None, best_scores)]
    for name, keys in list(CANDIDATES.items())[1:]:
        tried = []
        for shape in SHAPES if keys != (LOAD,) else (None,):
            joined = with_friction(columns, friction, shape, list(itertools.product(keys, range(n))))
            scores = _scores(joined, tau, used, weight, condition_max)
            if scores is not None:
                tried.append((shape, scores))
        if not tried:
            said.append(f"{name}: cannot be told apart by this motion")
            continue
        shape, scores = min(tried, key=lambda one: float(one[1].mean()))
        judged.append((keys, shape, scores))
        gain, error = _difference(best_scores, scores)
        share = gain / float(best_scores.mean())
        better = share > BETTER and clearly_larger(best_scores, scores)
        said.append(
            f"{name}: {'better' if better else 'no better'} than {best.name} "
            f"({share:+.0%} ± {error / float(best_scores.mean()):.0%} of the mean squared residual)"
        )
        if better:
            best, best_scores = Choice(name, keys, shape, ""), scores
    rivals = [
        (keys, shape) for keys, shape, scores in judged if keys != best.keys and not clearly_larger(scores, best_scores)
    ]
    return best._replace(reason="; ".join(said), rivals=tuple(rivals))


def _difference(scores: Vector, others: Vector) -> tuple[float, float]:
    """By how much these scores (FOLDS,) are larger, block by block, and the standard error of that."""
    by_block = scores - others
    return float(by_block.mean()), float(by_block.std(ddof=1)) / FOLDS**0.5


def clearly_larger(scores: Vector, others: Vector) -> bool:
    """Whether they are, by more than chance."""
    difference, error = _difference(scores, others)
    return difference > ERRORS * error


def _weights(columns: Matrix, tau: Matrix, used: NDArray[np.bool_]) -> Vector:
    """(n,) one over the rms of what the simplest candidate leaves over of each joint."""
    gram, right, _ = _normal(columns, tau, used, np.ones(tau.shape[1]))
    rest = (tau - columns @ np.linalg.lstsq(gram, right, rcond=None)[0]) * used
    rms: Vector = np.sqrt((rest**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1))
    return 1.0 / np.maximum(rms, 1e-9)


def _normal(columns: Matrix, tau: Matrix, used: NDArray[np.bool_], weight: Vector) -> tuple[Matrix, Vector, float]:
    """XᵀX (b, b), Xᵀτ (b,) and τᵀτ of the weighted equations."""
    w = used * weight
    X = (columns * w[:, :, None]).reshape(-1, columns.shape[2])
    y = (tau * w).ravel()
    return X.T @ X, X.T @ y, float(y @ y)


def _scores(
    columns: Matrix, tau: Matrix, used: NDArray[np.bool_], weight: Vector, condition_max: float
) -> Vector | None:
    """(FOLDS,) mean squared residual of each block by what the others say; None where columns are too alike."""
    cuts = np.linspace(0, len(tau), FOLDS + 1).astype(int)
    blocks = [slice(a, b) for a, b in itertools.pairwise(cuts)]
    parts = [_normal(columns[s], tau[s], used[s], weight) for s in blocks]
    gram, right = sum(p[0] for p in parts), sum(p[1] for p in parts)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    if not np.linalg.cond(gram / np.outer(scale, scale)) <= condition_max**2:
        return None
    scores = []
    for s, (own, own_right, own_square) in zip(blocks, parts, strict=True):
        value = (
            np.linalg.lstsq((gram - own) / np.outer(scale, scale), (right - own_right) / scale, rcond=None)[0] / scale
        )
        square = own_square - 2.0 * value @ own_right + value @ own @ value
        scores.append(float(square) / max(int(used[s].sum()), 1))
    return np.array(scores)
