"""A column that was not logged is an uncertainty that is said and compared, not an assumption."""

from dataclasses import replace

import pytest
from cases import diagnose, robot, simulated
from planted import planted

from casadical.diagnosis.candidates import choose, standard_candidates
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.text import page_of
from casadical.effects import BacklashByLoad


@pytest.mark.slow
def test_backlash_is_in_question_without_the_approaches_and_they_are_said_to_be_taken_from_the_order() -> None:
    """Play that friction holds needs the approach, which is not that from the order here."""
    m = simulated("kr210", 5, planted("backlash", 2, size=60e-6), n=80, drop=("approach",))
    d = diagnose(robot("kr210"), m)
    (cause,) = d.causes
    assert "backlash@2" in (cause.label, *cause.indistinguishable)
    assert "ASSUMED  approach1,2,3,4,5,6: the direction from the pose before" in page_of(d)
    assert any(text.startswith("approach1,2,3,4,5,6") for text in as_json(d, "campaign")["assumed"])


def test_what_stands_for_a_missing_column_is_no_candidate_where_it_was_logged() -> None:
    r = robot("ur10e")
    logged = simulated("ur10e", 3, n=30)
    bare = replace(logged, conditions={k: v for k, v in logged.conditions.items() if not k.startswith(("app", "temp"))})
    for m, there in ((logged, False), (bare, True)):
        found, _ = choose(standard_candidates(r), m)
        kinds = {type(e) for c in found if c.label == "backlash@3" for v in c.variants for e in v}
        assert (BacklashByLoad in kinds) is there
        assert ("a warm-up that was not measured" in {c.label for c in found}) is there


@pytest.mark.slow
def test_a_robot_that_warms_up_unmeasured_gets_no_cause_that_follows_something_else() -> None:
    hidden = planted("thermal_growth", size=25e-6)
    d = diagnose(robot("kr210"), simulated("kr210", 8, hidden, n=80, drop=("temperature",)))
    assert d.verdict != "explained"
    assert d.causes == ()
    assert "ASSUMED  temperature_degC: not known" in page_of(d)
