"""Are the certificates of this host valid, and for how long yet?"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Final

from agent.host.openssl import PkiError, validity
from agent.verify.finding import Finding, Verdict, judged, warning

WHERE: Final = "host"
FOLDER: Final = Path("/etc/coop/zenoh")  # where the units look for them (docs/security.md)
LEFT: Final = datetime.timedelta(days=14)


def certificates(folder: Path, now: datetime.datetime) -> list[Finding]:
    """A finding for each certificate of a folder; none where it has none.  now: UTC."""
    return [_finding(path, now) for path in sorted(folder.glob("*.pem"))]


def _finding(path: Path, now: datetime.datetime) -> Finding:
    try:
        begins, ends = validity(path)
    except PkiError as error:
        remedy = f"see `openssl x509 -noout -text -in {path}`; copy the one that `coop pki` has made here again"
        return warning(f"certificate {path.name}", WHERE, str(error.found), "one that can be read", remedy)
    found, remedy = f"until {ends:%Y-%m-%d %H:%M} UTC", f"`coop pki CELL FOLDER --renew {path.stem}`, and copy it here"
    if path.stem == "ca":
        remedy = "`coop pki` into a new folder: a new authority, for all hosts at once"
    if ends <= now:
        found = f"expired: {found}; telemetry has no link, the arms go on"
    elif begins > now:
        found = f"not valid before {begins:%Y-%m-%d %H:%M} UTC"
        remedy = "see the clock of this host (`chronyc tracking`), and that of the one which made it"
    return judged(
        f"certificate {path.name}", WHERE, found, f"valid, and for {LEFT.days} days yet",
        holds=begins <= now < ends - LEFT, remedy=remedy, otherwise=Verdict.WARNING,
    )  # fmt: skip
