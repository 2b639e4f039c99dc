"""Reads systemd unit files as systemd does, as far as our tests ask: drop-ins, lists, resets."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path

SYSTEMD = Path(__file__).parents[3] / "systemd"
SERVICES = ("coop-agent@left", "coop-telemetry@left", "coop-recorder", "coop-rings", "coop-ros2", "coop-guard@left")
OPTIONAL = ("coop-ros2",)  # started by nobody until it is enabled
SIMULATED = (*SERVICES, "coop-plant", "coop-telemetry@plant")

CHOICES: dict[str, tuple[str, ...]] = {
    "real": (),
    "simulated": ("simulated",),
    "several hosts": ("several-hosts",),
    "rehearsal": ("rehearsal",),
    "session": ("session",),
    "session on several hosts": ("session", "several-hosts"),
    "both": ("simulated", "several-hosts"),
}
CASES = [  # every unit under every choice of drop-ins
    (choices, name)
    for choices in CHOICES.values()
    for name in (SIMULATED if {"simulated", "rehearsal"} & set(choices) else SERVICES)
]

Unit = dict[str, list[str]]


def install(root: Path, *choices: str, of: Path = SYSTEMD) -> str:
    """What `systemd/install.sh` puts on a host, below root; what it says.  of: the units of a release."""
    done = subprocess.run(
        ["sh", str(of / "install.sh"), *choices],
        env=os.environ | {"DESTDIR": str(root)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def read_unit(root: Path, name: str) -> Unit:
    """Values of every key, with %i replaced and drop-ins applied; no key of ours is in two sections."""
    template, at, instance = name.partition("@")
    units = root / "etc/systemd/system"
    file = f"{template}{at}.service"
    unit: Unit = defaultdict(list)
    for path in [units / file, *sorted((units / f"{file}.d").glob("*.conf"))]:
        for key, value in _assignments(path.read_text()):
            if value:
                unit[key].append(value.replace("%i", instance))
            else:
                unit[key] = []
    return unit


def one(unit: Unit, key: str) -> str:
    """The value of a key that is given once."""
    (value,) = unit[key]
    return value


def words(unit: Unit, key: str) -> set[str]:
    """Words of a key that is a list."""
    return {word for value in unit[key] for word in value.split()}


def command(unit: Unit) -> list[str]:
    """Words of ExecStart, with variables of the unit's own Environment put in."""
    variables: dict[str, str] = {}
    for value in unit["Environment"]:
        for assignment in [value.strip('"')] if value.startswith('"') else value.split():
            name, _, text = assignment.partition("=")
            variables[name] = text
    found: list[str] = []
    for word in one(unit, "ExecStart").split():
        found += variables[word[1:]].split() if word.startswith("$") else [word]
    return found


def _assignments(text: str) -> list[tuple[str, str]]:
    lines = [line.strip() for line in text.splitlines()]
    plain = [line for line in lines if line and line[0] not in "#;["]
    return [(key.strip(), value.strip()) for key, _, value in (line.partition("=") for line in plain)]


def fake_root(root: Path, *choices: str) -> Path:
    """A root for `systemd-analyze --root`: the units, this host's own units, and every program they start."""
    install(root, *choices)
    shutil.copytree("/usr/lib/systemd/system", root / "usr/lib/systemd/system", symlinks=True)
    for program in ("opt/coop/bin/coop", "usr/bin/find", "bin/sh", "bin/rm"):
        path = root / program
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("#!/bin/sh\n")
        path.chmod(0o755)
    return root
