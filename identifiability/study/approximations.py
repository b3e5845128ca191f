"""The paper's analytical approximations of K and B at low and high frequencies (Table 1)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from identifiability.study.setting import Setting


def low_frequency(setting: Setting) -> tuple[float, float]:
    """K [Nm/rad] and B [Nms/rad] of slow perturbations: two springs in series (Eq. 8)."""
    share = setting.K_SE / (setting.K_CE + setting.K_SE)
    return setting.K_CE * share, setting.B_CE * share**2


def high_frequency(setting: Setting) -> tuple[float, float]:
    """K [Nm/rad] and B [Nms/rad] of fast perturbations: the tendon alone gives way (Eq. 11)."""
    return setting.K_SE, setting.I * setting.K_SE / setting.B_CE
