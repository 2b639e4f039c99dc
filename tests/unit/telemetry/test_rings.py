"""Which ring a telemetry process takes: its member's own, of the joints that the cell file says."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from agent.telemetry.link.publication import PublishOptions
from agent.telemetry.link.rings import wait_for_ring
from agent.telemetry.ring.file import RingError
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE

JOINTS = ("shoulder", "elbow")


def taken(ring: Path, member: str, joints: tuple[str, ...] | None = None, *, fresh: bool = False) -> str:
    """Whose ring telemetry of this member takes, if any; it looks at it once."""
    looks = iter([False])
    options = PublishOptions("paper", member, ring, joints=joints, fresh=fresh)
    reader = wait_for_ring(options, 1 << 62, lambda: next(looks, True), pytest.fail)
    if reader is None:
        return ""
    with closing(reader):
        return reader.header.name


@pytest.fixture
def ring(tmp_path: Path) -> Path:
    return tmp_path / "left.ring"


@pytest.mark.parametrize("joints", [None, JOINTS])
def test_its_own_ring_is_taken(ring: Path, joints: tuple[str, ...] | None) -> None:
    with RingWriter(ring, AGENT_STATE, "left", JOINTS, slots=2):
        assert taken(ring, "left", joints) == "left"


@pytest.mark.parametrize(
    ("member", "joints", "refused"),
    [
        (
            "right",
            None,
            "found the ring of 'left', expected that of 'right'; give the ring that",
        ),
        ("plant", (), "found the ring of 'left', expected that of 'plant'"),
        ("left", ("elbow", "shoulder"), "found joints shoulder, elbow, expected elbow, shoulder"),
        ("left", ("shoulder",), "found joints shoulder, elbow, expected shoulder"),
        ("left", (), "found joints shoulder, elbow, expected none"),
    ],
)
def test_another_ones_ring_or_one_of_other_joints_is_refused(
    ring: Path, member: str, joints: tuple[str, ...] | None, refused: str
) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    refusal = pytest.raises(RingError, match=f"telemetry ring {ring}: {refused}")
    with RingWriter(ring, AGENT_STATE, "left", JOINTS, slots=2), refusal:
        taken(ring, member, joints)
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_one_that_an_earlier_run_of_other_files_has_left_is_waited_past(ring: Path) -> None:
    RingWriter(ring, AGENT_STATE, "left", ("waist",), slots=2).close()
    assert taken(ring, "left", JOINTS, fresh=True) == ""
