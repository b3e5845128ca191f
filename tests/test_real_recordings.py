"""The investigation of real recordings whose missing effects are known; they are not shipped."""

import pytest

from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.measurement.filtering import noise_cutoff
from identifiability.measurement.readers import parse_columns, read_trial

pytestmark = pytest.mark.recordings


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
    assert not study.split.has_noise
    found = study.search()
    assert found.final.keys == ("cubic_stiffness",)
    assert not any(r.passes for r in found.rankings[0].ranked if r.key != "cubic_stiffness")
    assert found.baseline.held_out.error > 0.02
    assert found.final.held_out.error < 0.0005
    # By fine steps 3.782; by one second-order step a sample 3.94.
    assert found.final.values["cubic_stiffness.coefficient"] == pytest.approx(3.782, rel=0.01)


def test_the_pendulum_has_gravity_then_friction_then_a_shift_of_the_channels(shared_data):
    record = read_trial(
        shared_data / "real" / "dfki_pendulum_ddp.csv",
        columns=parse_columns(["time=time:s", "angle=position:rad", "torque=torque:Nm"]),
        driven="angle",
    )
    # Its encoder's step, 0.0029 rad in 250 Hz, is a noise of 2.8e-9 rad²/Hz; the motion's spectrum
    # is as large at 12 Hz.
    assert noise_cutoff([record]) == pytest.approx(12.5)
    study = Investigation([record])
    # A swing-up: the second half goes over the top, the first swings by half a radian.
    assert "first half" in study.split.how_held_out
    found = study.search(most=3)
    # Friction and a damping that saturates are nearly one curve; springs are not gravity.
    first, second, third = (m.key for m in found.missing)
    friction = {"coulomb_friction", "hill_force_velocity"}
    assert (first, second in friction, third) == ("gravity", True, "sensor_delay")
    as_well = {m.key: {r.key for r in m.equals if r.key not in m.near} for m in found.missing}
    # A spring that hardens predicts the other half worse, but with both fitted it does as well.
    assert as_well[first] <= {"cubic_stiffness"}
    assert found.missing[0].name == "gravity"
    assert friction <= {second} | as_well[second]
    assert not as_well[third]
    rungs = found.ladder
    fitted = [100 * (1 - rung.fitted.error) for rung in rungs]
    assert fitted == pytest.approx([58.7, 96.4, 96.7, 97.6], abs=0.3)  # K may not be negative
    held_out = [100 * (1 - rung.held_out.error) for rung in rungs]
    assert held_out == pytest.approx([57.1, 88.0, 93.3, 93.5], abs=0.5)
    # Elsewhere: 2.8 to 3.3 Nm, and some 16 ms.
    assert found.final.values["gravity.moment"] == pytest.approx(3.1, abs=0.3)
    assert found.final.values["sensor_delay.delay"] == pytest.approx(-0.014, abs=0.003)


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
    # Of one muscle, and activated as a critically damped system, it predicts as well, and starts
    # where the reflex of the ankle does: delay and activation trade.
    plainer = {"asymmetry": (0.999, 1.0), "damping_ratio": (0.999, 1.001)}
    bounds = {f"stretch_reflex.{name}": pair for name, pair in plainer.items()}
    model = KBI() + EFFECTS["stretch_reflex"]()
    one_sided = Investigation([record], bounds=bounds).fit(model, refined=True)
    assert 100 * (1 - one_sided.held_out.error) == pytest.approx(95.1, abs=0.3)
    assert one_sided.values["stretch_reflex.delay"] == pytest.approx(0.05, abs=0.008)
