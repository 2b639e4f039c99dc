"""Zenoh configurations of a cell's members: the shipped files of systemd/several-hosts/zenoh, filled in.

A test holds them equal to those, key by key.  An arm may publish under its own name and ask what the recorder has.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from agent.telemetry.row.topics import PLANT, RECORDER, ROOT

_PUBLISHES: Final = ("put", "reply", "declare_queryable", "liveliness_token")
_ASKS: Final = ("query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber")
_STATUS: Final = f"{ROOT}/*/{RECORDER}/status"


@dataclass(frozen=True, slots=True)
class Paths:
    """Where a member finds its files."""

    authority: Path
    certificate: Path
    key: Path


# A viewer that stands still loses rows, and no arm waits for it (agent.telemetry.link.session).
_PASSED_ON: Final = {
    "messages": ["put"], "key_exprs": ["**"], "flows": ["egress"], "overwrite": {"congestion_control": "drop"},
}  # fmt: skip


def common_name(member: str) -> str:
    """The name in a member's certificate, which access control goes by."""
    return member if member in (PLANT, RECORDER) else f"arm-{member}"


def member_config(paths: Paths, endpoint: str) -> bytes:
    """Of an arm's telemetry: dials the recorder, listens nowhere."""
    tls = {
        "connect_certificate": str(paths.certificate),
        "connect_private_key": str(paths.key),
        "verify_name_on_connect": True,
    }
    queue = {"congestion_control": {"drop": {"wait_before_drop": 0}, "block": {"wait_before_close": 200000}}}
    dialling = {
        "endpoints": [endpoint],
        "exit_on_failure": False,
        "retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    return _text({
        "mode": "peer",
        "listen": {"endpoints": []},
        "connect": dialling,
        **_common(paths, tls, max_sessions=1, accept_pending=1, tx={"queue": queue}),
    })  # fmt: skip


def recorder_config(paths: Paths, endpoint: str, cell: str, members: Sequence[str]) -> bytes:
    """Of the recorder: the only one that listens; whoever is not in the table gets nothing through."""
    tls = {"listen_certificate": str(paths.certificate), "listen_private_key": str(paths.key)}
    sizes = {"id": "size", "flows": ["ingress"], "messages": ["put", "reply"], "key_exprs": ["**"]}
    return _text({
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        "connect": {"endpoints": []},
        **_common(paths, tls, max_sessions=16, accept_pending=4, tx={"queue": {"size": {"data": 16}}}),
        "qos": {"network": [_PASSED_ON]},
        "access_control": _access(cell, members),
        "low_pass_filter": [sizes | {"size_limit": 262144}],
    })  # fmt: skip


def _common(
    paths: Paths, tls: dict[str, Any], *, max_sessions: int, accept_pending: int, tx: dict[str, Any] | None = None
) -> dict[str, Any]:
    link: dict[str, Any] = {
        "protocols": ["tls"],
        "tls": {
            "root_ca_certificate": str(paths.authority),
            "enable_mtls": True,
            "close_link_on_expiration": True,
            **tls,
        },
        "rx": {"max_message_size": 1048576},
    }
    times = {"open_timeout": 2000, "accept_timeout": 2000}
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "unicast": {**times, "max_sessions": max_sessions, "accept_pending": accept_pending},
            "link": link if tx is None else {**link, "tx": tx},
            "shared_memory": {"enabled": False},
        },
        "adminspace": {"enabled": False},
        "plugins_loading": {"enabled": False},
    }


def _access(cell: str, members: Sequence[str]) -> dict[str, Any]:
    """Deny by default; `**` does not match what begins with @, so each key stands with its @adv keys."""
    own = [
        _rule(f"own-{member}", "ingress", _PUBLISHES, *_with_history(f"{ROOT}/{cell}/{member}")) for member in members
    ]
    shared = [
        _rule("recorder-asks", "egress", _ASKS, *_with_history(ROOT)),
        _rule("arm-asks", "ingress", ("query",), _STATUS),
        _rule("recorder-answers", "egress", ("reply", "declare_queryable"), _STATUS),
    ]
    names = [rule["id"] for rule in shared]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": own + shared,
        "subjects": [{"id": member, "cert_common_names": [common_name(member)]} for member in members],
        "policies": [{"rules": [f"own-{member}", *names], "subjects": [member]} for member in members],
    }


def _with_history(key: str) -> tuple[str, str]:
    return f"{key}/**", f"{key}/**/@adv/**"


def _rule(name: str, flow: str, messages: Sequence[str], *keys: str) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}


def _text(config: dict[str, Any]) -> bytes:
    return (json.dumps(config, indent=2) + "\n").encode()
