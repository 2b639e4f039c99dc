"""Certificates of a cell and the shipped Zenoh configurations filled in, for tests; valid for two days, on loopback."""

from __future__ import annotations

import subprocess
from pathlib import Path

# Common names as in systemd/several-hosts/zenoh/recorder.json5.  "unknown" is of this cell, but not in that table;
# "foreign" calls itself arm-left and is of another cell.
SUBJECTS = {
    "recorder": "recorder", "left": "arm-left", "right": "arm-right", "plant": "plant", "unknown": "arm-unknown",
}  # fmt: skip
CURVE = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
EXTENSIONS = "subjectAltName=DNS:localhost,DNS:recorder.cell\nbasicConstraints=CA:FALSE\n"
EXTENSIONS += "extendedKeyUsage=serverAuth,clientAuth\n"


def make_certificates(folder: Path) -> Path:
    """`folder` with NAME.pem and NAME.key of every subject, and cell.pem, the authority that signed them."""
    folder.mkdir()
    (folder / "extensions").write_text(EXTENSIONS)
    for authority in ("cell", "other"):
        _openssl(folder, "req", "-x509", *CURVE, "-keyout", f"{authority}.key", "-out", f"{authority}.pem",
                 "-subj", f"/CN={authority}", "-days", "2", "-addext", "keyUsage=keyCertSign")  # fmt: skip
    for name, subject in SUBJECTS.items():
        _sign(folder, "cell", name, subject)
    _sign(folder, "other", "foreign", SUBJECTS["left"])
    return folder


def fill_in(configuration: str, name: str) -> str:
    """What a person writes into a shipped configuration, for an arm and a recorder on one host."""
    return configuration.replace("NAME", name).replace("0.0.0.0", "127.0.0.1")


def _sign(folder: Path, authority: str, name: str, subject: str) -> None:
    _openssl(folder, "req", *CURVE, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={subject}")
    _openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{authority}.pem", "-CAkey", f"{authority}.key",
             "-CAcreateserial", "-out", f"{name}.pem", "-days", "2", "-extfile", "extensions")  # fmt: skip


def _openssl(folder: Path, *arguments: str) -> None:
    done = subprocess.run(["openssl", *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
