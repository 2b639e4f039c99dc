"""With TLS, client certificates and access control (fault N3), only an arm's own telemetry gets into the log."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
import zenoh

from agent.log.read import read_log
from agent.telemetry.link.publish import Pace
from agent.telemetry.link.session import Network, NetworkError, has_link, open_session
from agent.telemetry.link.wire import BatchHeader
from tests.support.telemetry.telemetry_cell import ARMS, make_rows, recorder, telemetry, writer

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="makes its certificates with openssl")

LEFT = {"left": ARMS["left"]}


def openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True, timeout=60)


def certificate(folder: Path, name: str, authority: str) -> None:
    """Key and certificate `name` of an authority, valid for localhost."""
    openssl(folder, "req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", f"/CN={name}",
            "-keyout", f"{name}.key", "-out", f"{name}.csr")  # fmt: skip
    (folder / "ext").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{authority}.pem", "-CAkey", f"{authority}.key",
            "-CAcreateserial", "-days", "2", "-extfile", "ext", "-out", f"{name}.pem")  # fmt: skip


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    for authority in ("cell", "other"):
        openssl(folder, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                "-subj", f"/CN={authority}", "-keyout", f"{authority}.key", "-out", f"{authority}.pem")  # fmt: skip
    for name in ("recorder", "arm-left", "arm-right"):
        certificate(folder, name, "cell")
    certificate(folder, "stranger", "other")
    return folder


def rule(name: str, messages: list[str], flow: str, keys: list[str]) -> dict[str, Any]:
    return {"id": name, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": keys}


def access(arms: list[str]) -> dict[str, Any]:
    """Deny by default: an arm publishes under its own name only, and may ask the recorder for its status."""
    every, status = ["coop/paper/**", "coop/paper/**/@adv/**"], ["coop/paper/recorder/status"]
    asking = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
    rules = [
        rule("ask", asking, "egress", every),
        rule("status", ["query"], "ingress", status),
        rule("answer", ["reply", "declare_queryable"], "egress", status),
    ]
    subjects, policies = [], []
    for arm in arms:
        own = [f"coop/paper/{arm}/**", f"coop/paper/{arm}/**/@adv/**"]
        rules.append(rule(f"publish-{arm}", ["put", "delete"], "ingress", own))
        rules.append(rule(f"reply-{arm}", ["reply", "declare_queryable", "liveliness_token"], "ingress", own))
        subjects.append({"id": arm, "cert_common_names": [f"arm-{arm}"]})
        policies.append({"rules": [f"publish-{arm}", f"reply-{arm}", "ask", "status", "answer"], "subjects": [arm]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def config_file(folder: Path, keys: Path, name: str, port: int, *, authority: str = "cell") -> Path:
    """Zenoh configuration of the recorder, or of whoever connects with certificate `name`."""
    side = "listen" if name == "recorder" else "connect"
    tls = {
        "root_ca_certificate": str(keys / f"{authority}.pem"),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        f"{side}_certificate": str(keys / f"{name}.pem"),
        f"{side}_private_key": str(keys / f"{name}.key"),
    }
    endpoint = [f"tls/127.0.0.1:{port}"]
    config = {
        "mode": "peer",
        "listen": {"endpoints": endpoint if name == "recorder" else []},
        "connect": {"endpoints": [] if name == "recorder" else endpoint, "exit_on_failure": False,
                    "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"protocols": ["tls"], "tls": tls, "rx": {"max_message_size": 1 << 20}},
                      "shared_memory": {"enabled": False}},
    }  # fmt: skip
    if name == "recorder":
        config["access_control"] = access(["left", "right"])
    path = folder / f"{name}.json5"
    path.write_text(json.dumps(config))
    return path


def free_port() -> int:
    with open_session(Network(listen="tcp/127.0.0.1:0")) as opened:
        assert opened.endpoint is not None
        return int(opened.endpoint.rpartition(":")[2])


def forge(network: Network, *, may_connect: bool) -> None:
    """Publish rows as the left arm would, from somewhere else."""
    rows = make_rows("left", 8)
    rows["sequence"] += 10_000
    with contextlib.suppress(NetworkError), open_session(network) as opened:
        for i in range(20):
            header = BatchHeader(4711, 8 * i, 8 * i + 8, 0).pack()
            opened.session.put("coop/paper/left/state", rows.tobytes(), attachment=header,
                               congestion_control=zenoh.CongestionControl.BLOCK)  # fmt: skip
            time.sleep(0.02)
        assert has_link(opened.session) == may_connect


@pytest.mark.fault("N3")
def test_only_the_arm_itself_gets_into_the_log(tmp_path: Path, keys: Path) -> None:
    port = free_port()
    ring = tmp_path / "left.ring"
    network = Network(config_file=config_file(tmp_path, keys, "recorder", port))
    with recorder(tmp_path / "run.mcap", arms=LEFT, network=network) as rec:
        rec.ready()
        forge(Network(connect=(f"tcp/127.0.0.1:{port}",)), may_connect=False)
        forge(Network(config_file=config_file(tmp_path, keys, "stranger", port)), may_connect=False)
        forge(Network(config_file=config_file(tmp_path, keys, "arm-right", port)), may_connect=True)
        own = Network(config_file=config_file(tmp_path, keys, "arm-left", port))
        with telemetry(ring, "left", "", Pace.REAL_TIME, network=own) as tel, writer(ring, "left", 400, 500.0):
            assert tel.result().complete
        report = rec.stop()
    assert report.complete
    assert not [key for key in report.completeness if key.startswith("rejected.")]
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == make_rows("left", 400).tobytes()


@pytest.mark.parametrize(
    "mistake", ['{"mode": "peer", "lissten": {}}', '{"transport": {"link": {"tls": {"enable_mtsl": 1}}}}', "{"]
)
def test_a_configuration_with_a_mistake_is_refused(tmp_path: Path, mistake: str) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text(mistake)
    with pytest.raises(NetworkError, match="Zenoh configuration"), open_session(Network(config_file=path)):
        pass
