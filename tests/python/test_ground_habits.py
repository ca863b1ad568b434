"""What a ground station asks for when it connects and what scripts do without asking works: docs/mavsdk.md has the list.

`UPDATE_DOCS=1 tests/python/run.sh test_ground_habits.py` writes the list anew.
"""

import contextlib
import json
import os

import pytest

from ground_habits import PARTS
from stack import HERE, TOP, Process, free_simulator, venv_python

PAGE = TOP / "docs" / "mavsdk.md"
LIMIT_S = 240.0
# The parts of each vehicle, which takes about as long as the others.
VEHICLES = [("connect", "flight"), ("ways",), ("failures", "offboard")]


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Runs all parts, those of different vehicles side by side."""
    folder = tmp_path_factory.mktemp("ground_habits")
    with contextlib.ExitStack() as stack:
        running = []
        for parts in VEHICLES:
            simulator = stack.enter_context(free_simulator("wide_field.toml", folder))
            command = [venv_python("pymavlink"), "-u", HERE / "ground_habits.py", *parts, "--instance", simulator.instance]
            running.append(stack.enter_context(Process(f"ground_habits_{parts[0]}", command, folder)))
        found = {}
        for script in running:
            assert script.wait(LIMIT_S) == 0, script.said()
            found |= json.loads(script.lines[-1])
        yield {part: found[part] for part in PARTS}


@pytest.mark.parametrize("part", PARTS)
def test_every_item_works(outcomes, part):
    assert outcomes[part].keys() == PARTS[part].keys()
    assert {name: outcome for name, outcome in outcomes[part].items() if outcome != "works"} == {}


def test_the_documentation_has_the_outcomes(outcomes):
    table = "".join(f"- {name}\n" for part in outcomes.values() for name in part)
    text = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- habits: generated -->\n", "<!-- habits: end -->"
    before, rest = text.split(begin)
    written, after = rest.split(end, 1)
    if os.environ.get("UPDATE_DOCS"):
        PAGE.write_text(before + begin + table + end + after, encoding="utf-8")
        return
    assert written == table, "UPDATE_DOCS=1 writes it anew"
