"""A cell's authority, certificates and Zenoh configurations in one folder: all or nothing, renewed by name."""

from __future__ import annotations

import datetime
import ipaddress
import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from agent.atomic import is_full
from agent.config.files import CellFiles
from agent.config.schema.driver import DriverKind
from agent.host.openssl import PkiError, validity
from agent.pki import PORT
from agent.pki.certificates import Leaf, cell_of, hosts, make_authority, sign
from agent.pki.zenoh import Paths, common_name, member_config, recorder_config
from agent.telemetry.row.topics import PLANT, RECORDER

ETC: Final = Path("/etc/coop")
_LABEL: Final = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(?<!-)")  # of a host's name
_NAME_MAX: Final = 253
_UNIT: Final = {True: "coop-recorder.service", False: "coop-telemetry@{}.service"}  # by: is the recorder


@dataclass(frozen=True)
class Wish:
    """What is wanted of a cell's certificates."""

    cell: CellFiles
    folder: Path
    recorder: str = "recorder.cell"  # name or address that arms dial
    listen: str = "0.0.0.0"  # of the recorder's host; the units' IP filter admits the arms alone
    port: int = PORT
    days: int = 365
    in_place: bool = False  # configurations name the files in this folder, not those that systemd hands over

    @property
    def members(self) -> tuple[str, ...]:
        """Who publishes: the arms, and the simulated plant."""
        plant = (PLANT,) if self.cell.file.driver is DriverKind.SIM else ()
        return (*(arm.name for arm in self.cell.arms), *plant)


def make(wish: Wish) -> dict[str, datetime.datetime]:
    """Everything, into a folder that is not there yet; the end of each certificate by member.  Raises PkiError."""
    folder = wish.folder.absolute()
    dialled = _endpoint("--recorder", wish.recorder, wish.port)
    listening = _endpoint("--listen", wish.listen, wish.port)
    if os.path.lexists(folder):
        raise PkiError(
            f"folder {folder}", found="something of that name", expected="none, so that no key is replaced unasked",
            remedy="name another, or renew single certificates with --renew NAME",
        )  # fmt: skip
    try:
        scratch = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))  # mode 0700
    except OSError as error:
        raise _unwritten(folder, error) from error
    try:
        authority = scratch / "authority"
        authority.mkdir(mode=0o700)
        make_authority(authority, wish.cell.file.name)
        for member in (RECORDER, *wish.members):
            _member(wish, scratch, member, listening if member == RECORDER else dialled)
        scratch.rename(folder)
    except BaseException as error:
        shutil.rmtree(scratch, ignore_errors=True)
        if isinstance(error, OSError):
            raise _unwritten(folder, error) from error
        raise
    return ends(folder)


def renew(wish: Wish, names: Sequence[str]) -> dict[str, datetime.datetime]:
    """New certificates and keys of these members, for the same hosts; all else stays.  Raises PkiError."""
    folder = wish.folder.absolute()
    known = [RECORDER, *wish.members]
    for name in names:
        if name not in known:
            raise PkiError("member to renew", found=repr(name), expected=", ".join(known), remedy="name one of them")
    if not (folder / "authority/ca.key").is_file():
        raise PkiError(
            f"folder {folder}", found="no authority/ca.key", expected="a folder that `coop pki` has made",
            remedy="bring the key from where it is kept",
        )  # fmt: skip
    if (cell := cell_of(folder / "authority")) != wish.cell.file.name:
        raise PkiError(
            f"folder {folder}", found=f"the authority of cell {cell}", expected=f"that of {wish.cell.file.name}",
            remedy="name the cell that it was made for, or make a folder for this one",
        )  # fmt: skip
    for name in names:
        try:
            _renew(folder, name, wish.days)
        except OSError as error:
            raise _unwritten(folder, error) from error
    return ends(folder)


def _renew(folder: Path, name: str, days: int) -> None:
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        part = Path(scratch)
        leaf = Leaf(common_name(name), hosts(folder / name / "zenoh" / f"{name}.pem"))
        sign(folder / "authority", part, name, leaf, days)
        (part / f"{name}.pem").chmod(0o644)
        (part / f"{name}.key").rename(folder / name / "keys" / f"{name}.pem")
        (part / f"{name}.pem").rename(folder / name / "zenoh" / f"{name}.pem")


def _unwritten(folder: Path, error: OSError) -> PkiError:
    """Why the files of a folder cannot be written."""
    full = is_full(error)
    return PkiError(
        f"folder {folder}", found=error.strerror,
        expected="room for keys and certificates" if full else "a folder that can be written",
        remedy="make room there, or name another path" if full else "name another path",
    )  # fmt: skip


def ends(folder: Path) -> dict[str, datetime.datetime]:
    """When each certificate of a folder ends, the authority's first.  Raises PkiError."""
    found = {
        path.parents[1].name: validity(path).ends
        for path in sorted(folder.glob("*/zenoh/*.pem"))
        if path.name != "ca.pem"
    }
    return {"authority": validity(folder / "authority/ca.pem").ends, **found}


def _endpoint(option: str, host: str, port: int) -> str:
    """Where the recorder is, for Zenoh.  Raises PkiError for what is neither a name nor an address."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        labels = host.split(".")
        if len(host) > _NAME_MAX or not all(map(_LABEL.fullmatch, labels)) or labels[-1].isdigit():
            raise PkiError(
                f"option {option}", found=repr(host),
                expected="a host's name or address, such as recorder.cell or 10.0.0.1", remedy="correct it",
            ) from None  # fmt: skip
        return f"tls/{host}:{port}"
    return f"tls/{f'[{address}]' if address.version == 6 else address}:{port}"


def _member(wish: Wish, folder: Path, member: str, endpoint: str) -> None:
    """The files of one member as they lie below /etc/coop on its host; endpoint: the recorder's, as seen there."""
    public, secret = folder / member / "zenoh", folder / member / "keys"
    public.mkdir(parents=True)
    secret.mkdir(mode=0o700)
    sign(folder / "authority", public, member, _leaf(wish, member), wish.days)
    (public / f"{member}.key").rename(secret / f"{member}.pem")
    shutil.copyfile(folder / "authority/ca.pem", public / "ca.pem")
    if member == RECORDER:
        config = recorder_config(_paths(wish, member), endpoint, wish.cell.file.name, wish.members)
    else:
        config = member_config(_paths(wish, member), endpoint)
    (public / f"{member}.json5").write_bytes(config)
    for path in public.iterdir():
        path.chmod(0o644)


def _paths(wish: Wish, member: str) -> Paths:
    if wish.in_place:
        root = wish.folder.absolute() / member
        return Paths(root / "zenoh/ca.pem", root / f"zenoh/{member}.pem", root / f"keys/{member}.pem")
    unit = _UNIT[member == RECORDER].format(member)
    return Paths(ETC / "zenoh/ca.pem", ETC / f"zenoh/{member}.pem", Path(f"/run/credentials/{unit}/key.pem"))


def _leaf(wish: Wish, member: str) -> Leaf:
    return Leaf(common_name(member), (wish.recorder,) if member == RECORDER else ())
