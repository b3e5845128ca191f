"""One joint in several records: whether one model says that it is the same joint in all.

The model is fitted to each record alone, with the noise of each; then to all together, with what
should be the same shared (inertia, friction, gravity, whatever does not hang on how hard the muscle
works) and K and B of every record free. What that costs, twice the loss of log likelihood, is
chi-square distributed if the joint is the same (Wilks 1938, Ann Math Stat 9: 60-62): so it does not
depend on how a model is written, or on ridges along which its parameters lie.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from identifiability.errors import InputError
from identifiability.investigation.across.alone import FittedAlone, fitted_alone
from identifiability.investigation.across.together import Together, fit_together
from identifiability.investigation.session import Investigation
from identifiability.joint.model import Model
from identifiability.progress import Progress, silent

MAY_DIFFER = ("K", "B")
"""Parameters that follow activation and posture."""
_UNLIKELY = 0.01  # chance of records so far apart, if the joint were the same


@dataclass(frozen=True, eq=False)
class FittedRecord:
    """A model fitted to one record alone.

    Attributes
    ----------
    name : str
    values, sds : dict of str to float
        Of the free parameters, and their standard deviations by this record alone, whatever was
        known before. Angles are those of the record, not from where it rests; what is at a bound
        has no standard deviation.
    log_evidence : float
        Above that of K, B and I alone [nats].
    vaf : dict of str to float
        Of this record [%] as predicted by the fit of every record, K and B too, by its name.
    """

    name: str
    values: dict[str, float]
    sds: dict[str, float]
    log_evidence: float
    vaf: dict[str, float]


@dataclass(frozen=True)
class SharedParameter:
    """One parameter over all records.

    Attributes
    ----------
    name, unit : str
    shared : bool
        Whether it should be the same in all.
    value, sd : float
        Of all records together; of one that may differ its mean over them, and their scatter.
    chi_square : float
        Twice the log likelihood that is lost where this parameter alone is shared.
    n : int
        Number of records that tell it.
    p : float
        Chance of so much, if it were the same.
    spread : float
        Standard deviation over the records, over the mean.
    """

    name: str
    unit: str
    shared: bool
    value: float
    sd: float
    chi_square: float
    n: int
    p: float
    spread: float

    @property
    def verdict(self) -> Literal["agree", "differ", "one record"]:
        """Whether the records agree on it."""
        if self.n < 2:
            return "one record"
        return "differ" if self.p < _UNLIKELY else "agree"


@dataclass(frozen=True, eq=False)
class Across:
    """One model over several records.

    Attributes
    ----------
    model : Model
    records : tuple of FittedRecord
    parameters : tuple of SharedParameter
    chi_square : float
        Twice the log likelihood that is lost where all that should be the same is shared.
    degrees : int
        Its degrees of freedom.
    p : float
        Chance of so much, if all that is shared were the same.
    failures : dict of str to str
        Records that could not be fitted, and why; "all together", where that has no optimum.
    """

    model: Model
    records: tuple[FittedRecord, ...]
    parameters: tuple[SharedParameter, ...]
    chi_square: float
    degrees: int
    p: float
    failures: dict[str, str]

    @property
    def differing(self) -> tuple[SharedParameter, ...]:
        """What should be the same and is not."""
        return tuple(one for one in self.parameters if one.shared and one.verdict == "differ")


def across(
    records: Mapping[str, Investigation],
    model: Model,
    *,
    refined: Sequence[str] = (),
    may_differ: Sequence[str] = MAY_DIFFER,
    seed: int = 1,
    progress: Progress = silent,
) -> Across:
    """Fit one model to several records of a joint, and judge whether they agree.

    Parameters
    ----------
    records : mapping of str to Investigation
        By name; driven alike or not.
    model : Model
        What was found in one of them, or in several.
    refined : sequence of str
        Keys of effects whose refining parameters are free too.
    may_differ : sequence of str
        Parameters that may differ between records.
    seed : int
        Of the probes by which noise of an imposed angle is taken off.
    progress : callable
        Told ``(what, done, total)``.

    Raises
    ------
    InputError
        With fewer than two records, or two that can be fitted; or where a parameter that may
        differ is none of the model.
    """
    if len(records) < 2:
        raise InputError(f"found {len(records)} record, expected two or more of one joint")
    if unknown := sorted(set(may_differ) - set(model.parameter_names)):
        raise InputError(
            f"{', '.join(unknown)} may differ, but the model has "
            f"{', '.join(model.parameter_names)}: name some of these"
        )
    fitted: dict[str, FittedAlone] = {}
    failures: dict[str, str] = {}
    for i, (name, study) in enumerate(records.items()):
        progress(f"fitting {name}", i, len(records))
        try:
            with threadpool_limits(limits=1):
                fitted[name] = fitted_alone(study, model, refined, seed)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            failures[name] = str(error)
    if len(fitted) < 2:
        raise InputError(
            "fewer than two records can be fitted: "
            + "; ".join(f"{name}: {why}" for name, why in failures.items())
        )
    told = tuple(
        FittedRecord(
            of,
            dict(zip(one.names, map(float, one.recorded(one.found.x)), strict=True)),
            one.sds,
            one.log_evidence,
            {by: one.vaf(other.recorded(other.found.x)) for by, other in fitted.items()},
        )
        for of, one in fitted.items()
    )
    names = next(iter(fitted.values())).names
    shared = [name for name in names if name not in may_differ]
    parts = tuple(fitted.values())
    progress("fitting all together", len(records), len(records))
    with threadpool_limits(limits=1):
        together = fit_together(parts, shared)
        rows = tuple(
            _row(name, model.parameters[name].unit, told, parts, together)
            if name in shared
            else _own(name, model.parameters[name].unit, told)
            for name in names
        )
    if not together.at_optimum:
        failures["all together"] = "the fit with what is shared came to no end"
    degrees = sum(max(0, row.n - 1) for row in rows if row.shared)
    p = float(stats.chi2.sf(together.chi_square, degrees)) if degrees else 1.0
    return Across(model, told, rows, together.chi_square, degrees, p, failures)


def _row(
    name: str,
    unit: str,
    records: Sequence[FittedRecord],
    fits: Sequence[FittedAlone],
    together: Together,
) -> SharedParameter:
    """A parameter that should be the same: by all records, and what sharing it alone costs."""
    telling = [i for i, record in enumerate(records) if name in record.sds]
    lost = fit_together([fits[i] for i in telling], [name]).chi_square if len(telling) > 1 else 0.0
    p = float(stats.chi2.sf(lost, len(telling) - 1)) if len(telling) > 1 else 1.0
    values = np.array([record.values[name] for record in records])
    return SharedParameter(
        name,
        unit,
        True,
        together.values[name],
        together.sds[name],
        lost,
        len(telling),
        p,
        _spread(values),
    )


def _own(name: str, unit: str, records: Sequence[FittedRecord]) -> SharedParameter:
    """A parameter that may differ."""
    values = np.array([record.values[name] for record in records])
    n = sum(name in record.sds for record in records)
    scatter = float(np.std(values, ddof=1))
    middle = float(np.mean(values))
    return SharedParameter(name, unit, False, middle, scatter, 0.0, n, 1.0, _spread(values))


def _spread(values: np.ndarray) -> float:
    return float(np.std(values, ddof=1)) / max(abs(float(np.mean(values))), 1e-300)
