"""The gallery of effects: what each does to the response of one joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from identifiability.joint.effects import Effect
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.palette import BLUE, GREY
from identifiability.plots.style import styled

JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
"""K [Nm/rad], B [Nms/rad] and I [kg m²] of the joint that is drawn."""

_TIME = np.arange(1200) / 1000
_COLUMNS = 3


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
