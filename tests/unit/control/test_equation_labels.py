"""The paper's equation labels stand beside the lines that implement them: read from the sources, not run."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import agent

CONTROL = Path(agent.__file__).parent / "control"

# every equation label of the paper's TeX source
LABELS = {
    "quat_prod", "propagation rule", "propagation rule_1", "propagation rule_2",
    "coupled_kinematics", "coupled_kinematics_1", "eq:coupled_kinematics_2", "J_o_i", "J_o_i_dot", "J_o_i_def",
    "object dynamics", "manipulator dynamics", "manipulator dynamics_vector_form", "grasp matrix",
    "coupled dynamics", "coupled terms", "coupled M", "coupled C", "coupled g",
    "position error", "quat_error", "error_dynamics", "position error dynamics", "eta_error dynamics",
    "epsilon error dynamics", "errors to zero", "reference signals", "reference error",
    "control law", "control law vector form", "control_3", "V_dot",
    " parameter linearity ", "tmp", "parameter linearity 2",
    "adaptation errors", "adaptation errors_1", "adaptation errors_2",
    "adaptive control vector form", "adaptation laws",
}  # fmt: skip

# Where a label must stand: module, function, and what the statement beside it makes.
PLACES = {
    ("quaternion", "multiply", "return"): "quat_prod",
    ("trajectory_spline", "at", "wx"): "propagation rule_2",
    ("trajectory_spline", "at", "wy"): "propagation rule_2",
    ("trajectory_spline", "at", "wz"): "propagation rule_2",
    ("models", "__init__", "self.object_id"): "coupled_kinematics",
    ("models", "evaluate", "v_object"): "J_o_i",
    ("law", "reference", "dq_ref"): "J_o_i",
    ("law", "reference", "joints[DDQ_REF]"): "J_o_i_dot",
    ("law", "shift_to_ee", "return"): "J_o_i_def",
    ("law", "object_wrench", "return"): "object dynamics",
    ("known", "torque", "joints[INERTIA]"): "manipulator dynamics",
    ("known", "torque", "joints[CORIOLIS]"): "manipulator dynamics",
    ("known", "torque", "joints[GRAVITY]"): "manipulator dynamics",
    ("known", "torque", "tau_law"): "control law",
    ("errors", "evaluate", "e_p"): "position error",
    ("errors", "attitude_error", "e_eta"): "quat_error",
    ("errors", "attitude_error", "e_eps"): "quat_error",
    ("errors", "evaluate", "dpx, dpy, dpz"): "position error dynamics",
    ("errors", "evaluate", "de_eta"): "eta_error dynamics",
    ("errors", "evaluate", "dex"): "epsilon error dynamics",
    ("errors", "evaluate", "dey"): "epsilon error dynamics",
    ("errors", "evaluate", "dez"): "epsilon error dynamics",
    ("errors", "evaluate", "v_ref"): "reference signals",
    ("errors", "evaluate", "dv_ref"): "error_dynamics",
    ("errors", "evaluate", "e_v"): "reference error",
    ("internal_force", "internal_wrenches", "share"): "grasp matrix",
    ("internal_force", "about_object_centre", "return"): "grasp matrix",
    ("internal_force", "_at_end_effector", "return"): "J_o_i_def",
    ("stability", "coupled_inertia", "M"): "coupled M",
    ("regressor", "joint_regressor", "return"): " parameter linearity ",
    ("regressor", "object_regressor", "return"): " parameter linearity ",
    ("adaptation_bound", "believed_inertia", "M"): "parameter linearity 2",
    ("adaptation_bound", "_adaptation_matrices", "G_arm"): "tmp",
    ("adaptive", "torque", "tau_law"): "adaptive control vector form",
    ("adaptive", "torque", "arm_gradient[:inertial]"): "adaptation laws",
    ("adaptive", "torque", "object_gradient"): "adaptation laws",
    ("adaptation", "advance", "theta"): "adaptation laws",
    ("adaptation", "parameter_error", "error"): "adaptation errors",
}

# What no line of the product computes: rows that only number parts of another label, steps of the proofs that the tests
# retrace (tests/support/control, tests/property/control), and forms that stack all agents, of which one runs here.
NOT_COMPUTED = {
    "propagation rule", "propagation rule_1", "coupled_kinematics_1", "eq:coupled_kinematics_2",
    "manipulator dynamics_vector_form", "coupled dynamics", "coupled terms", "coupled C", "coupled g",
    "errors to zero", "control law vector form", "control_3", "V_dot", "adaptation errors_1", "adaptation errors_2",
}  # fmt: skip

CITED = re.compile("|".join(f"eq:{re.escape(label)}" for label in sorted(LABELS, key=len, reverse=True)))


def labels_beside_code(path: Path) -> Iterator[tuple[tuple[str, str, str], str]]:
    """Place (module, function, what the statement makes) and label of every comment that shares a line with code."""
    text = path.read_text(encoding="utf-8")
    functions = [f for f in ast.walk(ast.parse(text)) if isinstance(f, ast.FunctionDef)]
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type is tokenize.COMMENT and lines[token.start[0] - 1][: token.start[1]].strip():
            for cited in CITED.finditer(token.string):
                yield (path.stem, *_statement(functions, token.start[0])), cited[0].removeprefix("eq:")


def _statement(functions: list[ast.FunctionDef], line: int) -> tuple[str, str]:
    """Function that holds a line, and what its smallest statement makes: names, a call's last argument, `return`."""
    holding = [f for f in functions if f.lineno <= line <= (f.end_lineno or 0)]
    function = max(holding, key=lambda f: f.lineno)
    statements = [
        s
        for s in ast.walk(function)
        if isinstance(s, ast.Assign | ast.AugAssign | ast.AnnAssign | ast.Return | ast.Expr)
        and s.lineno <= line <= (s.end_lineno or 0)
    ]
    statement = max(statements, key=lambda s: s.lineno)
    if isinstance(statement, ast.Return):
        return function.name, "return"
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        return function.name, ast.unparse(statement.value.args[-1])
    targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
    return function.name, ", ".join(ast.unparse(t).strip("()") for t in targets)


@cache
def found() -> list[tuple[tuple[str, str, str], str]]:
    """All of them: looked for when the first test asks, not when tests are gathered, which each worker does."""
    return sorted(place for path in sorted(CONTROL.glob("*.py")) for place in labels_beside_code(path))


@pytest.mark.parametrize(("place", "label"), PLACES.items(), ids=[" ".join(p) for p in PLACES])
def test_label_stands_beside_the_line_that_implements_it(place: tuple[str, str, str], label: str) -> None:
    assert (place, label) in found()


def test_every_label_beside_code_is_listed_here() -> None:
    assert {place for place, _ in found()} == set(PLACES)


def test_every_equation_of_the_paper_has_its_line_or_a_reason_to_have_none() -> None:
    assert len(LABELS) == 40
    assert set(PLACES.values()) | NOT_COMPUTED == LABELS
    assert not set(PLACES.values()) & NOT_COMPUTED


@pytest.mark.parametrize("path", sorted(CONTROL.glob("*.py")), ids=lambda path: path.stem)
def test_no_label_is_cited_that_the_paper_does_not_have(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(CITED.findall(text)) == len(re.findall(r"(?<!:)\beq:(?=[ \w])", text))


def test_a_label_is_read_with_the_statement_that_it_stands_beside(tmp_path: Path) -> None:
    source = tmp_path / "made.py"
    source.write_text(
        "def f(a):\n    # eq:control_3\n    b = (\n        a,  # eq:coupled M\n    )\n    return b  # eq:tmp\n"
    )
    assert list(labels_beside_code(source)) == [(("made", "f", "b"), "coupled M"), (("made", "f", "return"), "tmp")]
