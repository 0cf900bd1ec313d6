"""The places that tools/mutate finds, what it makes of them, and how it finds them again. No mutant is tried here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tools.mutate import places, times

SRC = Path(__file__).parents[1] / "src"

SOURCE = '''"""A docstring, 3 - 1."""
from typing import TYPE_CHECKING

LIMIT = 2.0


class Brake:
    """Of an arm."""

    def step(self, speed: float, µ=3) -> float:
        self.count += 1
        if speed < LIMIT and (
            not self.on
        ):
            self.stop()
        return -speed - µ
'''


def mutants(operator: str) -> list[str]:
    """Returns the changed lines that an operator makes of the source, with `|` between two of them."""
    found = [place for place in places.find(SOURCE, "arm", "arm.py") if place.operator == operator]
    lines = SOURCE.splitlines()
    changed = [place.mutated(SOURCE).splitlines() for place in found]
    assert all(len(other) == len(lines) for other in changed)
    return ["|".join(b.strip() for a, b in zip(lines, other) if a != b) for other in changed]


@pytest.mark.parametrize(
    ("operator", "expected"),
    [
        ("constant", ["LIMIT = 3.0", "def step(self, speed: float, µ=4) -> float:", "self.count += 2"]),
        ("sign", ["self.count -= 1", "return -speed + µ", "return +speed - µ"]),
        ("compare", ["if speed > LIMIT and (", "if speed <= LIMIT and ("]),
        ("and/or", ["if speed < LIMIT or ("]),
        ("delete", ["pass", "pass", "return None"]),
        ("condition", ["if (not (speed < LIMIT and (|))):"]),
    ],
)
def test_the_mutants_of_each_operator(operator, expected):
    assert mutants(operator) == expected


def test_a_place_is_refused_in_other_source():
    with pytest.raises(ValueError):
        places.find(SOURCE, "arm", "arm.py")[0].mutated("LIMIT = 1.0\n")


def test_the_choice_is_in_proportion_and_repeatable():
    many = [place for i in range(30) for place in places.find(SOURCE, "large" if i < 20 else "small", f"{i}.py")]
    chosen = places.choose(many, 15, seed=4)
    assert [place.package for place in chosen].count("large") == 10 and len(chosen) == 15
    assert len({(place.file, place.line) for place in chosen}) == 15
    assert places.choose(many, 15, seed=4) == chosen != places.choose(many, 15, seed=5)


def test_places_are_found_again_when_moved_renamed_or_gone():
    saved = places.find(SOURCE, "arm", "arm.py")
    sign, compare, constant = (next(p for p in saved if p.operator == name) for name in ("sign", "compare", "constant"))
    changed = "\n\n" + SOURCE.replace("speed", "velocity").replace("LIMIT = 2.0", "pass")
    found = places.find_again([sign, compare, constant], places.find(changed, "arm", "other.py"), seed=0)
    assert [same for _, same in found] == [True, True, False]
    assert [place.before for place, _ in found[:2]] == ["+=", "<"]
    assert found[1][0].statement.startswith("if velocity < LIMIT")
    assert len({place.line for place, _ in found}) == 3


def test_two_statements_of_one_form_are_not_taken_for_each_other():
    place = next(p for p in places.find("a = b - c\n", "arm", "arm.py") if p.operator == "sign")
    candidates = places.find("d = e - f\ng = h - i\n", "arm", "arm.py")
    ((_, same),) = places.find_again([replace(place, statement="a = b - c")], candidates, seed=0)
    assert not same


def test_each_of_the_times_is_there_and_its_mutants_are_other_numbers():
    for file, names in times.TIMES.items():
        source = (SRC / file).read_text()
        found = times.find(source, "package", f"src/{file}", names)
        assert [place.statement for place in found] == [name for name in names.split() for _ in times.FACTORS]
        for place in found:
            number, other = float(place.before), float(place.after)
            assert number > 0.0 and f"x{other / number:g}" == place.operator
            assert place.mutated(source).count("\n") == source.count("\n")


def test_a_time_is_used_where_its_name_stands():
    place = times.find("A_S, B_S = 0.5, 2\nwait(A_S)\n", "arm", "src/arm/src/arm/waits.py", "A_S")[0]
    sources = {
        place.file: "A_S, B_S = 0.5, 2\nwait(A_S)\n",
        "src/arm/src/arm/a.py": "from arm.waits import B_S, A_S\n\nwait(B_S)\nwait(2.0 * A_S)\n",
        "src/arm/src/arm/b.py": "A_S = 3.0\n",
    }
    assert times.uses(place, sources) == {place.file: {1, 2}, "src/arm/src/arm/a.py": {1, 4}}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--count", "0"], "'0' is not a number from 1"),
        (["--limit", "nan"], "'nan' is not a number from 1"),
        pytest.param(["--root", "."], "'.' is no tree with a commit of git", marks=pytest.mark.long),
        (["--places", "nowhere.json"], "'nowhere.json' holds no result"),
        (["--places", "wrong.json"], "'wrong.json' holds no result"),
    ],
)
def test_what_cannot_be_tried_is_refused_in_a_sentence(tmp_path, monkeypatch, capsys, arguments, said):
    import tools.mutate.__main__ as mutate

    monkeypatch.setattr(mutate, "Trials", lambda *_: pytest.fail("it begins"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.json").write_text('{"mutants": [{}]}')
    with pytest.raises(SystemExit) as refused:
        mutate.main([*arguments, "--folder", str(tmp_path)])
    assert refused.value.code == 2 and said in capsys.readouterr().err
