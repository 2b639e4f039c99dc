"""The openssl command, and from when until when a certificate is valid."""

from __future__ import annotations

import datetime
import subprocess
from pathlib import Path
from typing import Final, NamedTuple

from drivers.interface import Refusal

_TIMEOUT_S: Final = 30.0


class PkiError(Refusal):
    """A certificate cannot be made or read."""


class Validity(NamedTuple):
    """Of a certificate, UTC."""

    begins: datetime.datetime
    ends: datetime.datetime


def validity(certificate: Path) -> Validity:
    """From when until when it counts.  Raises PkiError."""
    text = openssl(certificate.parent, "x509", "-in", certificate.name, "-noout", "-startdate", "-enddate")
    said = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    try:
        return Validity(_instant(said["notBefore"]), _instant(said["notAfter"]))
    except (KeyError, ValueError) as error:
        raise PkiError(
            f"certificate {certificate}", found=text.strip(), expected="its beginning and end", remedy="renew it"
        ) from error


def _instant(text: str) -> datetime.datetime:
    return datetime.datetime.strptime(text, "%b %d %H:%M:%S %Y GMT").replace(tzinfo=datetime.UTC)


def openssl(folder: Path, *words: str) -> str:
    """What the command with these words, run in a folder, says; its files are made 0600.  Raises PkiError."""
    try:
        done = subprocess.run(
            ["openssl", *words], cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL,
            timeout=_TIMEOUT_S, umask=0o077, check=False,
        )  # fmt: skip
    except OSError as error:
        raise PkiError(
            "command openssl", found=error.strerror, expected="OpenSSL 3", remedy="sudo apt install openssl"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise PkiError(
            f"openssl {words[0]} in {folder}", found=f"no end within {_TIMEOUT_S:g} s", expected="a certificate",
            remedy="look at the host's load, then try again",
        ) from error  # fmt: skip
    if done.returncode:
        raise PkiError(
            f"openssl {words[0]} in {folder}",
            found=(done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1],
            expected="a certificate",
            remedy="see whether ca.pem and ca.key are there, and belong together",
        )
    return done.stdout
