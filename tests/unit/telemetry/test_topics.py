"""Keys are made and read by one table, and a name that could break out of its place is refused."""

from __future__ import annotations

import pytest
import zenoh

from agent.telemetry.row import topics
from agent.telemetry.row.topics import Address, BadName, Kind


def test_keys_are_those_of_the_design() -> None:
    address = Address("paper", "left", Kind.STATE)
    assert address.key == "coop/paper/left/state"
    assert address.topic == "/coop/paper/left/state"
    assert address.replay_key == "replay/coop/paper/left/state"
    assert topics.status_key("paper") == "coop/paper/recorder/status"


@pytest.mark.parametrize("kind", Kind)
def test_a_topic_leads_back_to_its_address(kind: Kind) -> None:
    address = Address("two_wx200", "arm_1", kind)
    assert topics.parse_topic(address.topic) == address


@pytest.mark.parametrize(
    "topic", ["/tf", "/coop/paper/left", "/coop/paper/left/wrench", "/coop//left/state", "/a/b/c/state"]
)
def test_other_topics_are_not_ours(topic: str) -> None:
    assert topics.parse_topic(topic) is None


@pytest.mark.parametrize("name", ["", "Left", "le/ft", "*", "**", "left ", "1left", "a" * 33, "@adv", "l\n"])
def test_names_that_could_be_anything_else_are_refused(name: str) -> None:
    with pytest.raises(BadName, match="name of a"):
        Address("paper", name, Kind.STATE)
    with pytest.raises(BadName, match="name of a cell"):
        topics.cell_keys(name)


@pytest.mark.parametrize("name", ["plant", "recorder", "replay", "object"])
def test_an_arm_cannot_pass_for_something_else(name: str) -> None:
    with pytest.raises(BadName, match="name of an arm"):
        topics.check_arm_name(name)
    assert topics.check_arm_name("left") == "left"


def test_a_cell_hears_its_members_and_no_replay_and_no_other_cell() -> None:
    keys = zenoh.KeyExpr(topics.cell_keys("paper"))
    live = Address("paper", "left", Kind.STATE)
    assert keys.intersects(zenoh.KeyExpr(live.key))
    assert not keys.intersects(zenoh.KeyExpr(live.replay_key))
    assert not keys.intersects(zenoh.KeyExpr(Address("paper2", "left", Kind.STATE).key))


def test_no_key_commands_anything() -> None:
    assert {kind.value for kind in Kind} == {"state", "event", "health", "info"}
