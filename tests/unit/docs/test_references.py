"""What README and docs name is there: linked files and headings, paths, commands with their options, make targets."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.cli.main import whole
from tests.support.documents import DOCUMENTS, ROOT, read

TOP = "agent|configs|docs|drivers|sim_backend|systemd|tests"
PATH = re.compile(rf"(?<![\w/.@*-])(?:{TOP})/[\w./*@-]*")
COMMAND = re.compile(r"(?<![\w/.@-])(?:sudo )?(?:/opt/coop/bin/)?coop (?P<words>[a-z][^·|#;]*)")
MAKE = re.compile(r"(?:^|&& )make ([a-z][a-z-]*)")

pages = pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


@pages
def test_every_link_leads_to_a_file_and_a_heading(path: Path) -> None:
    page = read(path)
    for link in page.links:
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), link
        if anchor:
            assert anchor in read(target).anchors, link


@pages
def test_every_page_that_a_shipped_page_links_to_is_in_the_wheel_beside_it(path: Path) -> None:
    """Not the sources, which lie with the packages."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    beside = [ROOT / name for name in wheel["shared-data"]]
    assert any(path.is_relative_to(name) for name in beside), "it ships itself"
    for link in read(path).links:
        target = (path.parent / link.partition("#")[0]).resolve()
        if not re.match(r"[a-z]+:|#", link) and target.suffix != ".py":
            assert any(target.is_relative_to(name) for name in beside), link


@pages
def test_every_path_of_the_checkout_that_is_named_is_there(path: Path) -> None:
    for code in read(path).code:
        for name in PATH.findall(code):
            assert any(ROOT.glob(name.rstrip("./"))), f"{name} in `{code}`"


@pages
def test_every_command_and_option_that_is_named_exists(path: Path) -> None:
    root = whole()
    for code in read(path).code:
        for found in COMMAND.finditer(code):
            _follow(root, found["words"].split(), code)


def _follow(command: Any, words: list[str], code: str) -> None:
    """Go down groups, then hold every option against the command that was reached."""
    while hasattr(command, "commands") and words and re.fullmatch(r"[a-z][a-z0-9-]*", words[0]):
        assert words[0] in command.commands, f"no command {words[0]} in `{code}`"
        command, words = command.commands[words[0]], words[1:]
    options = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)} | {
        "--help"
    }
    for word in words:
        option = re.match(r"\[?(--[a-z][a-z-]*)", word)
        assert option is None or option[1] in options, f"{command.name} has no {option[1]} in `{code}`"


@pages
def test_every_make_target_that_is_named_exists(path: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for code in read(path).code:
        assert set(MAKE.findall(code)) <= targets, code


def test_the_readme_lists_every_command() -> None:
    listed = {found for code in read(ROOT / "README.md").code for found in re.findall(r"coop ([a-z0-9-]+)", code)}
    group: Any = whole()
    # these two stand in the table without the word `coop`, after `coop start`
    assert set(group.commands) - {"stop", "release"} <= listed


def test_the_page_of_documents_for_scripts_names_every_command_that_prints_one() -> None:
    text = (ROOT / "docs/commands.md").read_text().partition("## `--json`\n")[2]
    for name, command in _commands(whole()):
        if any("--json" in parameter.opts for parameter in command.params):
            assert re.search(rf"`{name}( --json)?`", text), name


def _commands(group: Any) -> Iterator[tuple[str, Any]]:
    """Every command by its words; those of `faults` print documents of one name."""
    for name, command in group.commands.items():
        if not hasattr(command, "commands"):
            yield name, command
            continue
        for below, of_group in command.commands.items():
            yield "faults" if name == "faults" else f"{name} {below}", of_group


def test_the_readme_lists_every_cell_that_ships() -> None:
    text = (ROOT / "README.md").read_text()
    cells = {path.name for path in (ROOT / "configs/cells").glob("*.toml")}
    # those that identify an arm carry nothing and have docs/identify.md
    assert {name for name in cells if not name.startswith("identify_")} <= set(re.findall(r"`(\w+\.toml)`", text))


def test_the_readme_says_what_every_dependency_is_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {re.split(r"[^\w-]", line)[0] for line in _dependencies(project)}
    table = read(ROOT / "README.md").code
    assert {name for name in named if not name.startswith("types-")} <= set(table)


def _dependencies(project: dict[str, object]) -> list[str]:
    plain, extras = project["dependencies"], project["optional-dependencies"]
    assert isinstance(plain, list)
    assert isinstance(extras, dict)
    return [*plain, *extras["dev"]]


def test_the_architecture_page_names_every_import_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    text = (ROOT / "docs/architecture.md").read_text()
    rows = {line.split("|")[1].strip() for line in text.splitlines() if line.startswith("| ")}
    assert {contract["name"] for contract in contracts} <= rows


def test_no_room_below_the_processes_may_name_a_concrete_driver() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    (held,) = (
        c["source_modules"] for c in contracts if c.get("forbidden_modules", [""])[0] == "drivers.dynamixel.driver"
    )
    below = [room for layer in layers[layers.index("agent.process") + 1 :] for room in layer.split(" | ")]
    assert {".".join(room.split(".")[:2]) for room in below if room.startswith("agent.")} == set(held)


@pytest.mark.parametrize("package", ["agent", "drivers", "sim_backend", "configs"])
def test_no_source_file_is_longer_than_the_house_has_it(package: str) -> None:
    lengths = {path: len(path.read_text().splitlines()) for path in (ROOT / package).rglob("*.py")}
    assert [str(path) for path, length in lengths.items() if length > 300] == []


def test_every_decision_is_in_the_list_of_decisions() -> None:
    folder = ROOT / "docs/decisions"
    records = {path.name for path in folder.glob("0*.md")}
    assert records == set(read(folder / "README.md").links)
    for name in records:
        text = (folder / name).read_text()
        assert all(f"**{part}.**" in text for part in ("Context", "Decision", "Consequence", "Figures")), name


def test_a_page_that_names_what_is_not_there_is_noticed(tmp_path: Path) -> None:
    wrong = {
        "[x](nowhere.md)": test_every_link_leads_to_a_file_and_a_heading,
        "[x](#nothing)": test_every_link_leads_to_a_file_and_a_heading,
        "`agent/nothing.py`": test_every_path_of_the_checkout_that_is_named_is_there,
        "`coop fly CELL`": test_every_command_and_option_that_is_named_exists,
        "`coop run CELL --nothing`": test_every_command_and_option_that_is_named_exists,
        "```\nmake nothing\n```": test_every_make_target_that_is_named_exists,
    }
    page = tmp_path / "page.md"
    for text, test in wrong.items():
        page.write_text(f"# Title\n\n{text}\n")
        with pytest.raises(AssertionError):
            test(page)
    page.write_text("# Title\n\n[x](#title) `coop motors scan --port X` `agent/loop.py` `make run`\n")
    for test in set(wrong.values()):
        test(page)
