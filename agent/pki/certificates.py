"""Certificates by the openssl command: an authority, and leaves that it signs.  Keys are made 0600."""

from __future__ import annotations

import ipaddress
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from agent.host.openssl import openssl

AUTHORITY_DAYS: Final = 3650
_OF_CELL: Final = "coop cell "  # begins the name of its authority
_CURVE: Final = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")


@dataclass(frozen=True, slots=True)
class Leaf:
    """What a certificate says."""

    common_name: str
    hosts: tuple[str, ...]  # names and addresses by which it is dialled; none: its common name


def make_authority(folder: Path, cell: str) -> None:
    """`ca.pem` and `ca.key` in the folder; it signs leaves and no further authority.  Raises PkiError."""
    openssl(
        folder, "req", "-x509", *_CURVE, "-keyout", "ca.key", "-out", "ca.pem", "-subj", f"/CN={_OF_CELL}{cell}",
        "-days", str(AUTHORITY_DAYS), "-addext", "keyUsage=critical,keyCertSign",
        "-addext", "basicConstraints=critical,CA:TRUE,pathlen:0",
    )  # fmt: skip


def cell_of(authority: Path) -> str:
    """The cell whose authority it is.  Raises PkiError."""
    subject = openssl(authority, "x509", "-in", "ca.pem", "-noout", "-subject", "-nameopt", "RFC2253")
    return subject.strip().removeprefix(f"subject=CN={_OF_CELL}")


def sign(authority: Path, folder: Path, name: str, leaf: Leaf, days: int) -> None:
    """`NAME.pem` and a new `NAME.key` in the folder, signed by `ca.key` of the authority's.  Raises PkiError."""
    extensions = [
        "subjectAltName=" + ",".join(map(_alternative, leaf.hosts or (leaf.common_name,))),
        "basicConstraints=critical,CA:FALSE",
        "keyUsage=critical,digitalSignature",
        "extendedKeyUsage=serverAuth,clientAuth",
    ]
    scratch = folder / f"{name}.ext", folder / f"{name}.csr"
    scratch[0].write_text("\n".join(extensions) + "\n")
    try:
        openssl(folder, "req", *_CURVE, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj",
                 f"/CN={leaf.common_name}")  # fmt: skip
        openssl(
            folder, "x509", "-req", "-in", f"{name}.csr", "-CA", str(authority / "ca.pem"), "-CAkey",
            str(authority / "ca.key"), "-set_serial", f"0x{secrets.token_hex(16)}", "-out", f"{name}.pem",
            "-days", str(days), "-extfile", f"{name}.ext",
        )  # fmt: skip
    finally:
        for path in scratch:
            path.unlink(missing_ok=True)


def hosts(certificate: Path) -> tuple[str, ...]:
    """Names and addresses by which its owner is dialled.  Raises PkiError."""
    lines = openssl(certificate.parent, "x509", "-in", certificate.name, "-noout", "-ext", "subjectAltName")
    names = lines.strip().splitlines()[-1].split(",")
    return tuple(name.strip().removeprefix("DNS:").removeprefix("IP Address:") for name in names)


def _alternative(host: str) -> str:
    try:
        return f"IP:{ipaddress.ip_address(host)}"
    except ValueError:
        return f"DNS:{host}"
