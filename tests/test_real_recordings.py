"""The investigation of real recordings whose missing effects are known; they are not shipped."""

import pytest

from identifiability.investigation.investigate import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.measurement.columns import parse_columns
from identifiability.measurement.readers import read_trial


def test_the_silverbox_has_a_cubic_spring_and_neither_a_quadratic_one_nor_friction(shared_data):
    record = read_trial(
        shared_data / "real" / "silverbox_SNLS80mV.csv",
        columns=parse_columns(["torque=V1:Nm", "angle=V2:rad"]),
        rate=610.35,
    )
    keys = ("cubic_stiffness", "quadratic_stiffness", "coulomb_friction")
    study = Investigation(
        [record],
        library={key: EFFECTS[key] for key in keys},
        bounds={"I": (1e-8, 1), "K": (0, 1000), "B": (0, 10)},
    )
    # The torque grows from nothing: what precedes the first onset is motion, not noise.
    assert not study.evidence.has_noise
    found = study.search(study.fit(KBI()))
    assert found.final.keys == ("cubic_stiffness",)
    assert not any(r.passes for r in found.steps[0].ranking if r.key != "cubic_stiffness")
    assert found.baseline.held_out.error > 0.02
    assert found.final.held_out.error < 0.0005
    assert found.final.values["cubic_stiffness.coefficient"] == pytest.approx(3.94, rel=0.02)


def test_the_pendulum_has_gravity_then_friction_then_a_shift_of_the_channels(shared_data):
    record = read_trial(
        shared_data / "real" / "dfki_pendulum_ddp.csv",
        columns=parse_columns(["time=time:s", "angle=position:rad", "torque=torque:Nm"]),
        driven="angle",
    )
    # One swing-up, whose halves are not alike: the ladder is that of the whole record.
    study = Investigation([record], [record], bounds={"I": (1e-4, 1)}, lowpass_hz=10.0)
    model, errors, values = KBI(), [], {}
    for key in ("", "gravity", "coulomb_friction", "sensor_delay"):
        model = model + EFFECTS[key]() if key else model
        fitted = study.fit(model)
        errors.append(fitted.fitted.error)
        values = fitted.values
    vaf = [100 * (1 - e) for e in errors]
    assert vaf[0] < 55  # K may not be negative
    assert vaf[1] == pytest.approx(95.9, abs=0.3)
    assert vaf[2] == pytest.approx(97.1, abs=0.3)
    assert vaf[3] == pytest.approx(97.4, abs=0.3)
    assert abs(values["sensor_delay.delay"]) == pytest.approx(0.011, abs=0.004)
    assert values["coulomb_friction.torque"] == pytest.approx(0.21, abs=0.05)


def test_the_ankle_has_a_stretch_reflex_and_no_sensor_shift(shared_data):
    record = read_trial(
        shared_data / "real" / "reklab_ankle_z.mat",
        columns=parse_columns(["angle=0:rad", "torque=1:Nm"]),
        variable="z",
        rate=1000.0,
        restoring=True,
        driven="angle",
    )
    study = Investigation([record])
    held_out = {
        key: study.fit(KBI() + EFFECTS[key](), refined=True).held_out.error
        for key in ("stretch_reflex", "series_tendon", "sensor_delay")
    }
    vaf = {key: 100 * (1 - error) for key, error in held_out.items()}
    plain = 100 * (1 - study.fit(KBI()).held_out.error)
    assert plain == pytest.approx(87.9, abs=0.3)
    assert vaf["stretch_reflex"] == pytest.approx(95.0, abs=0.3)
    assert vaf["series_tendon"] < plain + 0.5
    assert vaf["sensor_delay"] < plain + 0.5
