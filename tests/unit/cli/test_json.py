"""`--json`: one document on standard output and nothing else, of the shape that docs/commands.md gives."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.cli.documents import run_document
from agent.cli.options import print_json
from agent.config.cell import load_cell
from agent.log.read import RunLog
from agent.process.run import RunOutcome
from agent.report.compare import Change
from agent.report.metrics import summarise
from agent.verify import along
from tests.support.command import Done, coop
from tests.support.pages import told
from tests.support.telemetry.synthetic_run import paper_run

PAPER = configs.CELLS_DIR / "paper.toml"
CELL = load_cell(PAPER)


def document(done: Done) -> dict[str, Any]:
    """The one document; a NaN or Infinity, which are no JSON, is an error."""

    def refuse(word: str) -> None:
        raise AssertionError(word)

    found = json.loads(done.out, parse_constant=refuse)
    assert isinstance(found, dict)
    assert found["schema"] == 1
    assert set(found) <= told("commands.md")
    return found


def shape(thing: Any) -> Any:
    """Keys and types of a document; of a list that of its first element."""
    if isinstance(thing, dict):
        return {key: shape(value) for key, value in thing.items()}
    if isinstance(thing, list):
        return [shape(thing[0])] if thing else []
    return type(thing).__name__


FINDING = dict.fromkeys(("what", "where", "found", "wanted", "verdict", "remedy"), "str")
WORST_BARE = dict.fromkeys(("spectral_radius", "t_s", "delay_s", "inertia", "object"), "float") | {
    "arm": "str", "pads_N_per_m": "NoneType", "pads_Nm_per_rad": "NoneType",
}  # fmt: skip
LOAD = {"share_of_stall": "float", "arm": "str", "joint": "str", "t_s": "float"}
HEAD = {"schema": "int", "cell": "str", "fingerprint": "str"}


def test_check_gives_findings_a_verdict_and_the_start() -> None:
    done = coop("check", PAPER, "--json")
    assert (done.code, done.err) == (0, "")
    found = document(done)
    robustness = found.pop("robustness")
    assert set(robustness) == {"spectral_radius", "delay_margin_s", "worst", "one_arm_fails", "internal_wrench"}
    assert shape(robustness["internal_wrench"]["right"]) == {"force_N": "float", "moment_Nm": "float"}
    each = {"survivors": {"right": {key: kind for key, kind in LOAD.items() if key != "arm"}}}
    assert shape(robustness["one_arm_fails"]["left"]) == {
        "noticed_s": "NoneType",
        "limp": LOAD | each | {
            "sag_m": "float", "crept_m": "NoneType", "object": "str", "along": [LOAD | {"sag_m": "float"}]
        },
        "locked": LOAD | each | {"along": [LOAD | {"noticed_s": "NoneType"}]},
        "holding": LOAD | each | {"along": [LOAD | {"noticed_s": "NoneType"}]},
    }  # fmt: skip
    for fault in ("limp", "locked", "holding"):
        worst = robustness["one_arm_fails"]["left"][fault]
        along = worst.pop("along")
        assert worst["survivors"]["right"].items() <= worst.items()
        assert len({one["t_s"] for one in along}) == len(along) > 40
        assert max(along, key=lambda one: one["share_of_stall"]).items() & worst.items() >= {
            (key, worst[key]) for key in LOAD
        }  # fmt: skip
    assert shape(robustness["worst"]["bare"]) == WORST_BARE
    assert shape(found) == HEAD | {
        "verdict": "str", "findings": [FINDING], "q_start_rad": {"left": ["float"], "right": ["float"]},
    }  # fmt: skip
    assert found["verdict"] == "warning"
    assert (found["cell"], found["fingerprint"]) == ("paper", CELL.fingerprint)
    assert {f["verdict"] for f in found["findings"]} == {"ok", "warning"}
    assert all(bool(f["remedy"]) == (f["verdict"] != "ok") for f in found["findings"])
    assert [len(q) for q in found["q_start_rad"].values()] == [3, 3]


def test_a_refused_cell_is_a_document_an_error_line_and_an_exit_code() -> None:
    done = coop("check", PAPER, "--set", "rate_hz=120.0", "--json")
    assert done.code == 2
    found = document(done)
    assert found["verdict"] == "refused"
    assert any(f["verdict"] == "refused" and "spectral radius" in f["what"] for f in found["findings"])
    assert done.err.count("\n") == 1
    assert "spectral radius" in done.err


def test_check_refuses_what_the_servo_buses_could_not_carry_though_the_cell_is_simulated() -> None:
    done = coop("check", PAPER, "--set", "rate_hz=400.0", "--json")
    assert done.code == 2
    refused = {(f["what"], f["where"]) for f in document(done)["findings"] if f["verdict"] == "refused"}
    assert refused == {("rate on the servo bus", "left"), ("rate on the servo bus", "right")}


def test_what_cannot_be_examined_is_an_error_line_and_no_document(tmp_path: Path) -> None:
    for command in ("check", "tune"):
        done = coop(command, tmp_path / "none.toml", "--json")
        assert (done.code, done.out) == (2, "")
        assert done.err.count("\n") == 1


ARM = {"k_v_N_s_per_m": ["float"], "k_v_Nm_s_per_rad": ["float"], "torque_noise_Nm": "float"}
GAINS: dict[str, Any] = {
    "k_p_per_s": ["float"], "k_p_rate_per_s": ["float"], "k_eps_rad_per_s": ["float"],
    "k_eps_rate_rad_per_s": ["float"],
    "observer": {"position_gain": "float", "velocity_gain": "float", "velocity_from_position_per_s": "float"},
    "arms": {"left": ARM, "right": ARM},
    "loop": [{"inertia_error": "float", "spectral_radius": "float", "damping_ratio": "float"}],
    "slowest_time_constant_s": "float", "worst_spectral_radius": "float", "delay_margin_s": "NoneType",
}  # fmt: skip


def test_tune_gives_the_gains_there_are_and_those_proposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(along, "PLACES", 3)  # of the motion
    written = tmp_path / "new.toml"
    done = coop("tune", PAPER, "--form", "rate", "--radius", "0.99", "--write", written, "--json")
    assert done.code == 0, done.err
    found = document(done)
    change = {"table": "str", "name": "str", "key": "str", "value": "float"}
    proposals = found["proposals"]
    assert proposals.keys() == {"ratio", "rate"}
    for proposal in proposals.values():
        changes = proposal.pop("changes")
        assert {tuple(sorted(c)) for c in changes} == {tuple(sorted(change))}
        assert all(c["name"] in (None, "left", "right") for c in changes)
    margin = {"radius": "float", "damping": "float", "worst": "float"}
    proposals["rate"]["delay_margin_s"] = proposals["ratio"]["delay_margin_s"] = None  # a number where there is one
    assert shape(found) == HEAD | {
        "rate_hz": "float", "margin": margin, "configured": GAINS,
        "proposals": {"ratio": GAINS, "rate": GAINS}, "chosen": "str", "began": "str", "written": "str",
    }  # fmt: skip
    assert found["margin"] == {"radius": 0.99, "damping": 0.05, "worst": 0.985}
    assert (found["chosen"], found["began"], found["written"]) == ("rate", "configured", str(written))
    assert found["configured"]["k_p_per_s"] == [150.0] * 3
    assert [place["inertia_error"] for place in found["configured"]["loop"]] == [0.0, -0.3, 0.3]
    assert proposals["rate"]["loop"][1]["damping_ratio"] >= 0.05 > found["configured"]["loop"][1]["damping_ratio"]
    after = load_cell(written).file
    assert (
        proposals["rate"]["k_eps_rate_rad_per_s"][0]
        == (after.controller.k_eps_rate_rad_per_s or after.controller.k_eps_rad_per_s)[0]
    )
    assert proposals["rate"]["arms"]["left"]["k_v_Nm_s_per_rad"] == list(after.arms[0].k_v_Nm_s_per_rad or ())


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_run_says_how_it_ended(interrupted: bool) -> None:
    results = summarise(paper_run(Path("run.mcap"), duration_s=22.0))
    outcome = RunOutcome(Path("out/run.mcap"), Path("out/report.html"), results, interrupted, not interrupted)
    document = run_document(outcome)
    assert document == {
        "schema": 1, "log": "out/run.mcap", "report": "out/report.html", "interrupted": interrupted,
        "gave_up": None, "within_bounds": not interrupted, "results": results.to_json(),
    }  # fmt: skip
    assert set(document) <= told("commands.md")
    assert set(results.to_json()) <= told("report.md")


def test_a_session_that_was_given_up_says_why_and_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    results = summarise(paper_run(Path("run.mcap"), duration_s=22.0))
    outcome = RunOutcome(Path("run.mcap"), None, results, False, True, "left: closed on nothing")
    monkeypatch.setattr("agent.process.run.run_cell", lambda *_: outcome)
    done = coop("run", "two_wx200", "--wire", "--whole", "--json")
    assert (done.code, done.err) == (5, "coop: the session was given up: left: closed on nothing\n")
    assert document(done)["gave_up"] == "left: closed on nothing"


def test_no_document_has_what_is_no_json() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        print_json({"radius": float("nan")})


@pytest.fixture
def two_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    """`a.mcap` and `b.mcap`, the second with a larger error and without a plant."""
    logs: dict[str, RunLog] = {
        "a.mcap": paper_run(Path("a.mcap"), duration_s=22.0),
        "b.mcap": paper_run(Path("b.mcap"), duration_s=22.0, plant=False),
    }
    for rows in logs["b.mcap"].agents.values():
        rows["p_object"][:, 1] += 1e-3
    monkeypatch.setattr("agent.log.read.open_log", lambda path: nullcontext(logs[path.name]))


def test_compare_gives_every_figure_of_both(two_logs: None) -> None:
    done = coop("compare", "a.mcap", "b.mcap", "--json")
    assert (done.code, done.err) == (0, "")
    found = document(done)
    run = {"log": "str", "cell": "str", "fingerprint": "str", "driver": "str", "rate_hz": "float"}
    figures, settings = found.pop("figures"), found.pop("settings")
    assert found.pop("runs") == [found["a"], found["b"]]
    assert shape(found) == {"schema": "int", "a": run, "b": run}
    assert settings == []
    assert (found["a"]["log"], found["b"]["log"]) == ("a.mcap", "b.mcap")
    by_name = {figure["name"]: figure for figure in figures}
    assert len(by_name) == len(figures) > 100
    assert all(set(f) == {"name", "unit", "a", "b", "relative", "change", "values", "changes"} for f in figures)
    assert {f["change"] for f in figures} <= {change.name.lower() for change in Change}
    largest = by_name["max_position_error_m"]
    assert largest["change"] == "worse"
    assert largest["values"] == [largest["a"], largest["b"]]
    assert largest["changes"] == ["same", "worse"]
    assert largest["relative"] == pytest.approx(largest["b"] / largest["a"] - 1.0)
    assert by_name["arms.left.load_share_realised"]["change"] == "gone"
    assert by_name["arms.left.load_share_realised"]["b"] is None
    assert by_name["rms_position_error_m"]["unit"] == "m"


def test_compare_holds_several_logs_against_the_first(two_logs: None) -> None:
    found = document(coop("compare", "b.mcap", "a.mcap", "b.mcap", "--json"))
    assert [run["log"] for run in found["runs"]] == ["b.mcap", "a.mcap", "b.mcap"]
    by_name = {figure["name"]: figure for figure in found["figures"]}
    largest = by_name["max_position_error_m"]
    assert largest["changes"] == ["same", "better", "same"]
    assert largest["values"][0] == largest["values"][2] != largest["values"][1]
    assert by_name["arms.left.load_share_realised"]["changes"] == ["unknown", "appeared", "unknown"]


def test_one_log_is_nothing_to_compare(two_logs: None) -> None:
    done = coop("compare", "a.mcap")
    assert done.code == 2
    assert "found 1 logs, expected 2 to 26" in done.err


def test_a_comparison_is_a_page_that_is_not_written_over(two_logs: None, tmp_path: Path) -> None:
    page = tmp_path / "compare.html"
    assert coop("compare", "a.mcap", "b.mcap", "--html", page).code == 0
    assert "2 runs of paper" in page.read_text()
    again = coop("compare", "a.mcap", "b.mcap", "--html", page)
    assert again.code == 2
    assert "compare.html: found one of that name, expected none; name another, or give --force" in again.err
    assert coop("compare", "a.mcap", "b.mcap", "--html", page, "--force").code == 0


def test_compare_cuts_no_name_where_there_is_no_terminal(two_logs: None) -> None:
    done = coop("compare", "a.mcap", "b.mcap")
    names = [f["name"] for f in document(coop("compare", "a.mcap", "b.mcap", "--json"))["figures"]]
    shown = [line.split()[0] for line in done.out.splitlines() if line.split() and line.split()[0] in names]
    assert len(shown) == len(set(shown)) > 30
    assert "…" not in done.out
    assert max(len(name) for name in shown) > 40
