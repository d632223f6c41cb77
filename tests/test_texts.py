"""`scripts.texts` draws texts of every kind, the same ones for the same seed."""

from scripts.texts import drawn, messages


def test_the_same_seed_draws_the_same_texts_of_all_kinds():
    once = drawn(15, "a")
    assert once == drawn(15, "a")
    assert len(set(once)) == 15
    assert sum(place.endswith(".md") for place, _ in once) == 3
    assert sum("docstring of" in place for place, _ in once) == 3


def test_messages_are_those_of_errors():
    found = dict(messages("recon/core/arrays.py"))
    assert any("expected" in text for text in found.values())


def test_programs_that_raise_the_exit_code_of_a_command_raise_no_message():
    """`raise SystemExit(run_command(lambda: ...))` was drawn as the message of an error."""
    assert not any("lambda" in text for _, text in messages("training/__main__.py"))
