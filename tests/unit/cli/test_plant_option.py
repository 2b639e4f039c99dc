"""What `coop plant` makes of an agent that dies: the run ends, or its arm goes limp, as the simulated unit wants it."""

from __future__ import annotations

import pytest

from agent.cli.main import dispatch
from agent.process import plant
from sim_backend.served.options import LostArm
from tests.support.systemd.unit_files import SYSTEMD


@pytest.mark.parametrize(("words", "wanted"), [((), LostArm.END_RUN), (("--lost-arm", "limp"), LostArm.GO_LIMP)])
def test_a_lost_arm_ends_the_run_unless_it_may_go_limp(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], wanted: LostArm
) -> None:
    got = {}
    monkeypatch.setattr(plant, "run_plant", lambda *_, **options: got.update(options) or "done")
    assert dispatch(["plant", "paper", *words]) == 0
    assert got["lost_arm"] is wanted


def test_the_simulated_unit_lets_a_lost_arm_go_limp() -> None:
    unit = (SYSTEMD / "simulated/coop-plant.service").read_text()
    (start,) = [line for line in unit.splitlines() if line.startswith("ExecStart=")]
    assert start.endswith("--real-time --lost-arm limp")
