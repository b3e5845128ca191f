"""What kind of thing a model lacks, and the torque it lacks, without naming an effect.

A candidate's residual is explained by Gaussian processes of several kinds: nothing but noise; a
drift of the sensor; a filter in the sensor; a torque of the present state, of the turning points
of the motion, of the past motion; stiffness that is not the same in every trial; a torque of its
own in every trial. Each has its marginal likelihood in closed form, in which every free parameter
of the candidate may move by 100 % and the noise, first-order autoregressive with a standard
deviation for each trial, is estimated anew.

No such kind is exact. Where a torque of its own in every trial explains more than a kind does, the
kind is therefore tried together with it, and with a second kind; the largest part gives the name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.unexplained.explanation import (
    REMAINDER,
    Explainer,
    Explanation,
    Family,
    explainer,
)
from identifiability.investigation.unexplained.readouts import (
    DelayReadout,
    MemoryKernel,
    MissingTorque,
    StaticMap,
    missing_torque,
    read_delay,
    static_map,
)
from identifiability.investigation.unexplained.traces import Response, bin_width, binned

DECISIVE = 5.0
"""Difference of log evidence, in nats, that decides between kinds: odds of 150 to 1 where both were
as likely before ("very strong", Kass & Raftery 1995, J Am Stat Assoc 90: 773-795)."""

KINDS = {
    "none": "noise",
    "drift": "a drift of the recording",
    "sensor": "a filter or delay in the recording",
    "static": "a torque of the present angle and velocity",
    "hysteresis": "a torque like dry friction",
    "memory": "a torque of the past motion",
    "unrepeatable": "a torque that differs from trial to trial",
}
"""Kinds of what may be missing, in words."""

_MOST = 0.8  # share of the misfit beyond the noise that counts as most of it: a convention
_LEAST_QUIET = 8  # bins that a level of the noise may be read from
_MOST_PAIRS = 3
_CLEAR, _FELT = 0.1, 0.01  # share of the margin, and s, from which a latency is spoken of


@dataclass(frozen=True, eq=False)
class Unexplained:
    """What is left by a model, and of what kind it is.

    Attributes
    ----------
    families : tuple of Family
        Best first: by evidence, but for a family whose functions of the motion serve all trials,
        which comes before those that differ by trial if it explains most of the misfit.
    margin : float
        Nats from the best family to the best of another kind.
    share : float
        Share of the residual's energy beyond the noise that the best family's repeatable part
        explains: all its terms but a torque of its own in each trial.
    torque : tuple of MissingTorque
        One a fitted trial, under the best family that is a torque.
    noise_ratio : float or None
        Standard deviation of the noise under the best family over that of the quiet samples,
        root mean square over trials; ``None`` without quiet samples.
    memory_kernel, delay_readout, static_map : optional
        Where the best family has such a part.
    """

    families: tuple[Family, ...]
    margin: float
    share: float
    torque: tuple[MissingTorque, ...]
    noise_ratio: float | None
    memory_kernel: MemoryKernel | None = None
    delay_readout: DelayReadout | None = None
    static_map: StaticMap | None = None

    @property
    def best(self) -> Family:
        """Family of the highest evidence."""
        return self.families[0]

    @property
    def rival(self) -> Family:
        """Best family of another kind."""
        return _rival(self.families)

    @property
    def decided(self) -> bool:
        """Whether the best family wins over every other kind by `DECISIVE` nats."""
        return self.margin >= DECISIVE

    @property
    def sentence(self) -> str:
        """The finding, in words."""
        if not self.decided:
            return (
                f"What is left could be {KINDS[self.best.kind]} or {KINDS[self.rival.kind]}: "
                "these data do not tell them apart."
            )
        return _sentence(self)


def unexplained(bench: Workbench, candidate: Candidate, *, seed: int = 1) -> Unexplained:
    """Say what kind of thing a candidate lacks, and estimate the torque that it lacks.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        A fitted model; the residuals are those of its fitted trials.
    seed : int
        Of the draws that bands are made of.

    Returns
    -------
    Unexplained
    """
    # Many small matrices: threads would cost more than they bring.
    with threadpool_limits(1):
        explains, response = explainer(bench, candidate)
        found = _explanations(explains)
        return _conclude(explains, response, found, seed)


def _explanations(explains: Explainer) -> list[Explanation]:
    """All explanations, best first; of each family the best, alone or with a remainder."""
    terms = explains.terms
    rest = terms[REMAINDER]
    found = {"none": explains.fit([])}
    for key, t in terms.items():
        try:
            found[key] = explains.fit([t])
        except np.linalg.LinAlgError:
            # A term that these data cannot tell from the model's own parameters.
            continue
    if REMAINDER not in found:
        return sorted(found.values(), key=lambda e: -e.log_evidence)
    level = found[REMAINDER].log_evidence
    best = dict(found)
    if level > found["none"].log_evidence + DECISIVE:
        for key, t in terms.items():
            if t.kind == "drift" or t is rest or key not in found:
                continue
            if found[key].log_evidence > level:
                continue
            both = explains.fit([t, rest], [*found[key].values, *found[REMAINDER].values])
            if both.log_evidence > best[key].log_evidence:
                best[key] = both
        for pair in _pairs(explains, best):
            best[pair.key] = pair
    return _preferred(sorted(best.values(), key=lambda e: -e.log_evidence))


def _preferred(found: list[Explanation]) -> list[Explanation]:
    """Best first: one function of the motion for all trials before what differs by trial.

    Stiffness or torque that is free in every trial can follow anything smooth, so it is believed
    only where no single function of the motion explains most of the misfit.
    """
    if found[0].kind != "unrepeatable":
        return found
    for e in found:
        if e.kind not in ("none", "drift", "unrepeatable") and e.explained > _MOST:
            return [e, *(other for other in found if other is not e)]
    return found


def _pairs(explains: Explainer, best: dict[str, Explanation]) -> list[Explanation]:
    """The best repeatable family and a second one, where it does not suffice alone."""
    ranked = sorted(best.values(), key=lambda e: -e.log_evidence)
    repeatable = [e for e in ranked if e.terms and e.terms[0].kind not in (REMAINDER, "drift")]
    first, *others = repeatable
    if not first.remainder:
        return []
    out = []
    for second in others[:_MOST_PAIRS]:
        terms = [first.terms[0], second.terms[0], explains.terms[REMAINDER]]
        starts = [first.values[0], second.values[0], first.values[-1]]
        out.append(explains.fit(terms, starts, sizes_only=True))
    return out


def _conclude(
    explains: Explainer,
    response: Response,
    found: Sequence[Explanation],
    seed: int,
) -> Unexplained:
    noise_alone = next(e for e in found if not e.terms).log_evidence
    families = tuple(e.family(noise_alone) for e in found)
    best = found[0]
    rival = _rival(families)
    torque_like = next(e for e in found if any(t.torques is not None for t in e.terms))
    torques, slopes = missing_torque(explains, torque_like, seed)
    kernel = readout = static = None
    if memories := [t for t in best.terms if t.kind == "memory"]:
        place = best.slices[best.terms.index(memories[0])]
        weights = best.posterior.common
        kernel = MemoryKernel(memories[0].nodes[0], weights.mean[place], weights.sd[place])
        readout = read_delay(explains, response, best, memories[0])
    if any(t.key == "static" for t in best.terms):
        static = static_map(best, slopes)
    return Unexplained(
        families,
        families[0].log_evidence - rival.log_evidence,
        best.explained,
        torques,
        _noise_ratio(explains, best),
        kernel,
        readout,
        static,
    )


def _rival(families: Sequence[Family]) -> Family:
    """Best family of another kind; one that differs by trial is no rival to one that does not."""
    best = families[0]
    others = [f for f in families if f.kind != best.kind]
    if best.kind != "unrepeatable":
        others = [f for f in others if f.kind != "unrepeatable"] or others
    return max(others, key=lambda f: f.log_evidence)


def _noise_ratio(explains: Explainer, found: Explanation) -> float | None:
    """Noise that an explanation needs, over that of the quiet samples."""
    width = bin_width(explains.traces)
    quiet = [binned(t.residual[: t.ready.lead.n_samples], width) for t in explains.traces]
    if any(q.size < _LEAST_QUIET for q in quiet):
        return None
    before = np.array([np.mean(q**2) for q in quiet])
    return float(np.sqrt(np.sum(found.noise.sds**2) / np.sum(before)))


def _sentence(result: Unexplained) -> str:
    best = result.best
    if best.kind == "none":
        words = "What is left is noise: nothing in it depends on the motion or repeats."
        if result.noise_ratio is not None and result.noise_ratio > 1.5:
            words = (
                "What is left looks like noise, but of "
                f"{result.noise_ratio:.1f} times the size it has before the perturbation."
            )
        return words
    readout = result.delay_readout
    lead = {
        "drift": "is a slow drift of the recording",
        "sensor": "looks as if the recording were filtered or delayed",
        "static": "behaves like a torque that depends on the present angle and velocity",
        "hysteresis": (
            "behaves like dry friction or a yielding element: a torque that depends on how far the "
            "joint has moved since it turned back"
        ),
        "memory": "behaves like a torque that depends on the past motion",
        "unrepeatable": (
            "is a torque that differs from trial to trial: no one function of the motion makes it"
        ),
    }[best.kind]
    main = max(best.shares, key=lambda key: best.shares[key])
    if main in ("variation", "varying"):
        when = "from trial to trial" if main == "variation" else "during the trials"
        lead = f"behaves like stiffness and damping that change {when}"
    if best.kind == "memory" and readout is not None:
        if readout.nats >= DECISIVE + _CLEAR * result.margin and readout.delay >= _FELT:
            lead += f", with a latency of about {1000 * readout.delay:.0f} ms"
        else:
            lead += f", and fades with a time constant of about {1000 * readout.decay:.0f} ms"
    if main in ("memory_positive", "memory_negative"):
        lead += f", and to motion in the {main.removeprefix('memory_')} direction only"
    words = f"What is left {lead}"
    if best.kind != "unrepeatable":
        words += f"; that explains {100 * result.share:.0f} % of it beyond the noise"
    return words + "."
