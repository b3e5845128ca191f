"""Effects that are added by least squares, whatever the colour of what is left."""

import pytest
from hidden import CONDITIONS, HELD, JOINT, PAIR, study_of_a_pair, trials

from identifiability.investigation.posterior import search
from identifiability.investigation.posterior.stepwise import stepwise
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI

KEYS = ("cubic_stiffness", "sensor_delay", "second_mass", "coulomb_friction")
LIBRARY = {key: EFFECTS[key] for key in KEYS}


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_what_is_missing_leaves_least(driven):
    study = study_of_a_pair(driven, KEYS)
    evaluator = study._evaluator(1)
    base = evaluator.evaluate(KBI(), [study.baseline.values])
    steps = list(stepwise(evaluator, base, LIBRARY, 3))
    sets = [set(step.model.effect_keys) for step in steps]
    assert sets[1] == {"cubic_stiffness", "sensor_delay"}
    # Three effects, then these without one of them each.
    assert [len(keys) for keys in sets] == [1, 2, 3, 2, 2, 2]
    assert all(keys < sets[2] for keys in sets[3:])
    assert len({frozenset(keys) for keys in sets[3:]}) == 3
    for name, value in PAIR.items():
        if name != "cubic_stiffness.centre":
            assert steps[1].values[name] == pytest.approx(value, rel=0.1)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_it_is_looked_for_before_something_unknown_is_said(driven, monkeypatch):
    """And where the most probable set leaves more than the noise of a good recording."""
    looked = []

    def none(*arguments):
        looked.append(arguments)
        return iter(())

    monkeypatch.setattr(search, "stepwise", none)
    size = 1.0 if driven == "torque" else 6.0
    # A pulse and a step: more trials make the same evidence larger.
    conditions = [(kind, size * strength) for kind, strength in CONDITIONS[::3]]

    def looks(model, values, noise, library):
        before = len(looked)
        parts = (
            trials(model, values, seed, noise=noise, conditions=c, driven=driven)
            for seed, c in ((3, conditions), (4, HELD[:1]))
        )
        Investigation(*parts, library={key: EFFECTS[key] for key in library}).weigh()
        return len(looked) > before

    spring = KBI() + EFFECTS["cubic_stiffness"]()
    values = {name: PAIR[name] for name in spring.parameter_names}
    assert not looks(KBI(), JOINT, 1e-3, ["cubic_stiffness"])
    assert looks(KBI(), JOINT, 0.6, ["cubic_stiffness"])
    assert not looks(spring, values, 1e-3, ["cubic_stiffness", "sensor_delay"])
    assert looks(spring, values, 1e-3, ["sensor_delay"])
