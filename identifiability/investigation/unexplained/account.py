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
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.rules import Rules
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

_LEAST_QUIET = 8  # bins that a level of the noise may be read from
_MOST_PAIRS = 3  # of a repeatable family and a second one that are tried


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
    rules : Rules
        What it was judged by.
    """

    families: tuple[Family, ...]
    margin: float
    share: float
    torque: tuple[MissingTorque, ...]
    noise_ratio: float | None
    memory_kernel: MemoryKernel | None = None
    delay_readout: DelayReadout | None = None
    static_map: StaticMap | None = None
    rules: Rules = field(default_factory=Rules)

    @property
    def best(self) -> Family:
        """Family of the highest evidence."""
        return self.families[0]

    @property
    def rival(self) -> Family:
        """Best family of another kind."""
        return _rival(self.families)

    @property
    def decisive(self) -> float:
        """Margin [nats] from which the best family wins over every other kind."""
        return self.rules.decisive_kind

    @property
    def decided(self) -> bool:
        """Whether the best family wins over every other kind."""
        return self.margin >= self.decisive

    @property
    def noise_suffices(self) -> bool:
        """Whether the best family needs no more noise than the quiet samples have, if any."""
        return self.noise_ratio is None or self.noise_ratio <= self.rules.enough_noise

    @property
    def latency(self) -> float | None:
        """Latency [s] of the torque, where the past motion makes it and the latency is clear."""
        readout, rules = self.delay_readout, self.rules
        if self.best.kind != "memory" or readout is None:
            return None
        clear = readout.nats >= self.decisive + rules.clear_latency * self.margin
        return readout.delay if clear and readout.delay >= rules.least_latency else None


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
        found = _explanations(explains, bench.rules)
        return _conclude(explains, response, found, bench.rules, seed)


def _explanations(explains: Explainer, rules: Rules) -> list[Explanation]:
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
    if level > found["none"].log_evidence + rules.decisive_kind:
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
    return _preferred(sorted(best.values(), key=lambda e: -e.log_evidence), rules.kind_share)


def _preferred(found: list[Explanation], kind_share: float) -> list[Explanation]:
    """Best first: one function of the motion for all trials before what differs by trial.

    Stiffness or torque that is free in every trial can follow anything smooth, so it is believed
    only where no single function of the motion explains most of the misfit.
    """
    if found[0].kind != "unrepeatable":
        return found
    for e in found:
        if e.kind not in ("none", "drift", "unrepeatable") and e.explained > kind_share:
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
    rules: Rules,
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
        rules,
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
