"""Random cases are drawn from their seed, counted by their result, and never run twice."""

import json

import pytest
from hypothesis import strategies as st

from benchmarks.stress import random_cases
from benchmarks.stress.outcome import Outcome
from benchmarks.stress.random_cases import BATCH, RARE, outcomes, run_all, summary


@pytest.fixture
def counted(monkeypatch):
    """A stage whose cases are numbers; numbers above 90 are wrong. Gives the list of cases run."""
    run = []

    def judge(number):
        run.append(number)
        return Outcome(1.0, 0.0, 0.0, off=float(number > 90))

    monkeypatch.setattr(random_cases, "STAGES", {"numbers": (lambda: st.integers(0, 100), judge)})
    return run


def test_a_run_that_was_ended_is_taken_up_where_it_was(counted, tmp_path, capsys):
    file = tmp_path / "cases.jsonl"
    run_all(file, BATCH, ("numbers",))
    once = len(counted)
    assert once >= BATCH - 1
    whole = file.read_text()
    # As a run that is killed while it writes leaves it.
    file.write_text(whole + '\n{"stage": "numbers", "batch": 1, "ca')
    broken = run_all(file, 2 * BATCH, ("numbers",))
    assert len(counted) < 2.2 * once
    assert file.read_text().startswith(whole)
    batches = [
        json.loads(line)["batch"] for line in file.read_text().splitlines() if line.endswith("}")
    ]
    assert batches == [0, 1]
    # About one in ten is wrong, and one in a thousand may be.
    assert broken and "confident and wrong" in capsys.readouterr().out
    again = len(counted)
    run_all(file, 2 * BATCH, ("numbers",))
    assert len(counted) == again


def test_cases_are_those_of_their_seed(counted):
    first, again, other = ([case for case, _ in outcomes("numbers", batch)] for batch in (5, 5, 6))
    assert first == again != other


def test_wrong_answers_of_one_in_a_thousand_are_not_rare():
    rows = [{"answered": 1.0, "off": 0.0, "wrong": 0.0} for _ in range(1000)]
    assert summary(rows)[1]
    for name in ("off", "wrong"):
        assert not summary([*rows[1:], rows[0] | {name: 1000 * RARE}])[1]


@pytest.mark.filterwarnings("ignore:next to no lenses are resolved:UserWarning")
@pytest.mark.parametrize(
    "stage",
    [
        "calibration",
        # Pictures that are no flats are refused in tests/lfcal/detection too.
        pytest.param("lookalikes", marks=pytest.mark.nightly),
        "depth",
        "rendering",
    ],
)
def test_every_stage_is_driven_by_what_hypothesis_draws(stage):
    found = outcomes(stage, 4, 4)
    assert len(found) >= 3
    assert len({case for case, _ in found}) >= 2
    # Which cases a seed gives depends on the modules that hypothesis has seen: how rare wrong
    # answers are is told by thousands of them, not by these.
    assert all(0 <= one.off <= one.answered <= 1 for _, one in found)
