"""The investigation of real recordings whose missing effects are known; they are not shipped."""

import pytest

from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.measurement.filtering import noise_cutoff
from identifiability.measurement.readers.columns import parse_columns
from identifiability.measurement.readers.trial_file import read_trial

pytestmark = pytest.mark.recordings


@pytest.mark.long
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
    posterior = study.weigh()
    assert posterior.present("cubic_stiffness") > 0.99
    for other in ("quadratic_stiffness", "coulomb_friction"):
        assert posterior.present(other) < 0.05
    found = study.climb(posterior)
    assert found.final.keys == ("cubic_stiffness",)
    assert found.baseline.held_out.error > 0.02
    assert found.final.held_out.error < 0.0005
    # By fine steps 3.78 to 3.80; by one second-order step a sample 3.94.
    assert found.final.values["cubic_stiffness.coefficient"] == pytest.approx(3.79, rel=0.01)


def test_the_pendulum_has_gravity_then_a_shift_of_the_channels_and_friction(shared_data):
    record = read_trial(
        shared_data / "real" / "dfki_pendulum_ddp.csv",
        columns=parse_columns(["time=time:s", "angle=position:rad", "torque=torque:Nm"]),
        driven="angle",
    )
    # Its encoder's step, 0.0029 rad in 250 Hz, is a noise of 2.8e-9 rad²/Hz; the motion's spectrum
    # is as large at 12 Hz.
    assert noise_cutoff([record]) == pytest.approx(12.5)
    keys = ("gravity", "coulomb_friction", "cubic_stiffness", "sensor_delay", "sensor_lowpass")
    study = Investigation([record], library={key: EFFECTS[key] for key in keys})
    # A swing-up: the second half goes over the top, the first swings by half a radian.
    assert "first half" in study.split.how_held_out
    posterior = study.weigh()
    for key in ("gravity", "sensor_delay"):
        assert posterior.present(key) > 0.9, key
    # A spring that hardens is not gravity.
    assert posterior.present("cubic_stiffness") < 0.1
    found = study.climb(posterior)
    first, *others = found.missing
    rungs = {m.key: m.rung.values for m in others}
    assert first.key == "gravity"
    assert set(rungs) == {"sensor_delay", "sensor_lowpass", "coulomb_friction"}
    held_out = [100 * (1 - rung.held_out.error) for rung in found.ladder]
    assert held_out[:2] == pytest.approx([57.5, 87.9], abs=0.5)
    assert held_out[-1] > 95
    # Elsewhere: 2.8 to 3.3 Nm, and some 16 ms.
    assert first.rung.values["gravity.moment"] == pytest.approx(3.0, abs=0.3)
    assert rungs["sensor_delay"]["sensor_delay.delay"] == pytest.approx(-0.016, abs=0.003)


@pytest.mark.parametrize(
    ("file", "rubs"),
    [
        ("dfki_pendulum_ddp.csv", True),
        pytest.param("dfki_pendulum_direct_collocation.csv", False, marks=pytest.mark.long),
    ],
)
def test_the_pendulum_whose_torque_is_imposed_has_gravity(shared_data, file, rubs):
    """By default settings; in one record friction is a clue beside it, and held out it shows."""
    columns = parse_columns(["time=time:s", "angle=position:rad", "torque=torque:Nm"])
    study = Investigation([read_trial(shared_data / "real" / file, columns=columns)])
    posterior = study.weigh()
    claim = study.claim(posterior)
    assert claim.sets == (("gravity",),)
    found = study.climb(posterior)
    assert found.missing[0].key == "gravity"
    assert found.baseline.held_out.error > 0.5
    assert found.missing[0].rung.held_out.error < 0.2
    if rubs:
        assert 1 - found.missing[0].rung.held_out.error > 0.95
        assert posterior.present("coulomb_friction") > 0.4
        assert [one.key for one in found.missing] == ["gravity", "coulomb_friction"]
        assert 1 - found.final.held_out.error > 0.98


@pytest.mark.long
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
