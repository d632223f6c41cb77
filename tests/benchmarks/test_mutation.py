"""The operators of mutation testing change what they say, and nothing else."""

from benchmarks.mutation import mutant, places

SOURCE = '''
def clipped(x: Float[Tensor, "n"] | None, low: float = 2.0) -> float:
    """A docstring with 3 numbers."""
    if x is None or not x > low:
        raise ValueError(f"expected more than {low + 1}")
    log.append(x)
    return max(x, -low) * 4
'''


def changes() -> set[tuple[str, str, str]]:
    found = [mutant(SOURCE, place) for place in places(SOURCE)]
    assert all(one.source != SOURCE for one in found)
    return {(one.operator, one.before, one.after) for one in found}


def test_every_operator_finds_its_place():
    assert {
        ("constant", "2.0", "4.0"),
        ("comparison", "x is None", "x is not None"),
        ("comparison", "x > low", "x >= low"),
        ("connective", "x is None or not x > low", "x is None and (not x > low)"),
        ("sign", "not x > low", "not not x > low"),
        ("sign", "-low", "+low"),
        ("function", "max", "min"),
        ("arithmetic", "max(x, -low) * 4", "max(x, -low) / 4"),
        ("constant", "4", "5"),
        ("statement left out", "log.append(x)", "None"),
    } <= changes()


def test_docstrings_annotations_and_messages_are_left_alone():
    said = [before + after for _, before, after in changes()]
    assert not any("docstring" in one and "if" not in one for one in said)
    assert not any("Tensor" in one or one == "low + 1" for one in said)
    # one fault at a time, in code that still compiles
    for place in places(SOURCE):
        compile(mutant(SOURCE, place).source, "mutant", "exec")
