"""The gallery of effects: what each does to the response of one joint, and what does nearly so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from identifiability.joint.effects import Effect
from identifiability.joint.model import KBI, Model
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion
from identifiability.palette import BLUE, GREY
from identifiability.plots.style import MODEL_COLOURS, PAGE, printed, styled

JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
"""K [Nm/rad], B [Nms/rad] and I [kg m²] of the joint that is drawn."""

_TIME = np.arange(1200) / 1000
_COLUMNS = 3
_SMOOTHING = 151  # samples over which a servo moves
_ANGLE = 0.1  # rad, of the imposed step


def gallery_figure(effects: Mapping[str, type[Effect]]) -> Figure:
    """Angle after a pulse and during a step, without and with every effect at its typical values.

    Parameters
    ----------
    effects : mapping of str to type of Effect
    """
    torque = 8.0 * ((_TIME > 0.05) & (_TIME <= 0.1)) + 4.0 * (_TIME > 0.6)
    drive = SampledTorque(torque).drive(_TIME)
    plain = simulate(KBI(), KBI().vector(JOINT), drive)
    rows = -(-len(effects) // _COLUMNS)
    with styled():
        figure = Figure(figsize=(10.0, 1.9 * rows + 0.5))
        axes = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
        for panel, kind in zip(axes.flat, effects.values(), strict=False):
            model = KBI() + kind()
            values = dict(zip(model.parameter_names, model.nominal, strict=True)) | JOINT
            panel.plot(_TIME, plain, color=GREY, lw=2.4)
            panel.plot(_TIME, simulate(model, model.vector(values), drive), color=BLUE, lw=1.4)
            panel.set_title(kind.key.replace("_", " "), fontsize=10)
        for panel in axes.flat[len(effects) :]:
            panel.set_visible(False)
        for panel in axes[-1]:
            panel.set_xlabel("time [s]")
        for panel in axes[:, 0]:
            panel.set_ylabel("angle [rad]")
        figure.suptitle(
            "A pulse of 8 Nm, then a step of 4 Nm: K, B and I (grey), and with the effect (blue)",
            fontsize=11,
        )
    return figure


@printed
def look_alikes_figure(key: str, effects: Mapping[str, type[Effect]]) -> Figure:
    """What K, B and I cannot do of an effect, beside what is confused with it.

    A pulse and a step of torque on the left, of angle on the right. Each effect has its typical
    values; of what it changes, the best K, B and I take their share, and the rest is drawn with its
    largest value as 1, turned so that it goes as the effect does.

    Parameters
    ----------
    key : str
        Of the effect.
    effects : mapping of str to type of Effect

    Raises
    ------
    KeyError
        Where there is no such effect.
    """
    kind = effects[key]
    shown = [key, *(k for k in kind.confused_with if k in effects)]
    figure = Figure(figsize=(PAGE, 1.8))
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for panel, drive, imposed in zip(panels, _drives(), ("torque", "angle"), strict=True):
        rests = _beyond_the_joint([KBI() + effects[one]() for one in shown], drive)
        for one, rest, colour in zip(shown, rests, MODEL_COLOURS, strict=False):
            turned = np.sign(rests[0] @ rest) or 1.0
            dashed = "-" if one == key else "--"
            label = one.replace("_", " ")
            panel.plot(_TIME, turned * rest, dashed, color=colour, label=label)
        panel.axhline(0.0, color=GREY, lw=0.6, zorder=0)
        panel.set_title(f"{imposed} imposed")
        panel.set_xlabel("time [s]")
    panels[0].set_ylabel("change beyond\nK, B and I, largest 1")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _drives() -> tuple[Drive, Drive]:
    """A pulse, then a step: of torque, and of angle by a servo."""
    pulse, step = (_TIME > 0.05) & (_TIME <= 0.1), _TIME > 0.6
    torque = SampledTorque(8.0 * pulse + 4.0 * step).drive(_TIME)
    window = np.hanning(_SMOOTHING)
    there = _ANGLE * (((_TIME > 0.1) & (_TIME <= 0.3)) + 1.0 * step)
    ends = np.pad(there, _SMOOTHING // 2, mode="edge")
    angle = np.convolve(ends, window / window.sum(), mode="valid")
    return torque, imposed_motion(_TIME, angle)


def _beyond_the_joint(models: Sequence[Model], drive: Drive) -> list[np.ndarray]:
    """Changes by models' effects, without what changes of K, B and I do; largest value 1."""
    plain = KBI()
    base = simulate(plain, plain.vector(JOINT), drive)
    slopes = [
        simulate(plain, plain.vector(JOINT | {name: 1.001 * JOINT[name]}), drive) - base
        for name in JOINT
    ]
    columns = np.column_stack([slope / np.linalg.norm(slope) for slope in slopes])
    out = []
    for model in models:
        values = dict(zip(model.parameter_names, model.nominal, strict=True)) | JOINT
        changed = simulate(model, model.vector(values), drive) - base
        rest = changed - columns @ np.linalg.lstsq(columns, changed, rcond=None)[0]
        out.append(rest / np.max(np.abs(rest)))
    return out
