"""docs/failures.md is what the code makes of it, and its reference names everything that can be told or refused."""

from __future__ import annotations

from tests.faults.page import PAGE, meanings, names, page, refusals, told


def test_the_page_is_what_its_sources_make_of_it() -> None:
    assert PAGE.read_text() == page(), "python -m tests.faults.page writes it"


def test_it_says_that_this_is_no_safety_function() -> None:
    assert "**This is no safety function.**" in page().partition("## ")[0]


def test_every_mode_flag_event_and_servo_fault_has_a_meaning_and_no_other_has() -> None:
    known = meanings()
    for kind, found in names().items():
        assert set(known[kind]) == found, f"tests/faults/meanings.toml, {kind}"


def test_every_exit_code_of_a_refusal_has_a_meaning() -> None:
    known = {int(code) for code in meanings()["exit_code"]}
    assert {kind.exit_code for kind in refusals()} <= known
    assert known == {0, 1, 2, 3, 4, 5, 6, 7, 8, 130}, "the table of docs/commands.md"


def test_every_text_that_a_process_tells_has_a_meaning_and_no_other_has() -> None:
    heads = set(meanings()["event"])
    begins = told()
    assert begins
    for text in begins:
        assert any(text.startswith(head) for head in heads), f"tests/faults/meanings.toml, event: {text!r}"
    for head in heads:
        assert any(text.startswith(head) for text in begins), f"nobody tells {head!r}"


def test_every_meaning_is_whole_and_every_refusal_says_what_it_is() -> None:
    for kind, found in meanings().items():
        for name, meaning in found.items():
            assert set(meaning) == {"means", "cause", "remedy"}, f"{kind} {name}"
            assert all(meaning.values()), f"{kind} {name}"
    assert all(kind.__doc__ for kind in refusals())
