"""Every convention of the investigation, in one record.

None of these numbers is measured: each is where a line was drawn, and why there. They are passed
down from `investigate`, and written into every record.
"""

from __future__ import annotations

from dataclasses import dataclass

from identifiability.joint import scheme


@dataclass(frozen=True)
class Rules:
    """Conventions by which effects are named and spoken of.

    Attributes
    ----------
    claimed : float
        Probability from which effects are named: a level that experimenters know.
    decisive_kind : float
        Difference of log evidence [nats] that decides between kinds of torque that no effect
        names: odds of 150 to 1 where both were as likely before.
    discrepancy : float
        Share of a trial's mean square that is added to its noise variance in the weights: the
        paper's dE. It keeps a nearly noiseless trial from deciding alone against models that are
        never exact.
    most_slack : float
        Largest relative uncertainty of the noise floor that is granted, however short the leads.
    explained_share : float
        Share of the held-out misfit beyond the noise that effects must remove to be named: those
        that leave more than they explain, where they were not fitted, are a clue.
    resolved : float
        Expected evidence, twice the difference of log likelihoods, at which an experiment settles a
        pair: odds of e to the 10th.
    kind_share : float
        Share of the misfit beyond the noise from which one function of the motion for all trials
        is preferred to what differs from trial to trial.
    trace_share : float
        Share of what is left, below which an account of it explains nothing; nor does, beside
        something unknown, a last effect that removes no more of the misfit.
    clear_latency : float
        Share of the margin by which a kind won that the log evidence of a latency must exceed,
        above `decisive_kind`, for the latency to be spoken of: in a kind that explains much, a
        small misfit of its kernel makes as much difference.
    least_latency : float
        Shortest latency [s] that is spoken of.
    notable : float
        Standard errors from which the change of one of K, B and I between parts of the trials is
        named, where they change at all.
    enough_noise : float
        Times the quiet samples' noise, beyond which an explanation is not complete.
    loose : float
        Half the 95 % interval over the value from which a parameter counts as not pinned down: its
        value is then known to a factor of three at best.
    noise_draws : int
        Draws of the noise, from whose median the smallest effect that would have been seen follows.
    false_discoveries : float
        Rate of false discoveries within each view of where a model fails, and over the aspects of
        its comparison (Benjamini & Hochberg 1995, J R Stat Soc B 57: 289-300).
    solver_share : float
        Error of a fit's integration, as E, over that of the noise, from which on the fit is
        repeated with finer steps.
    solver_most, solver_least : float
        Bounds of what it may be: where the noise is large or unknown, and where there is none.
    solver_nats : float
        Nats by which half the step may make the fitted trials more or less likely: the cost of a
        model with corners has ripples of about that size, in which a fit ends.
    trifle : float
        Share of the response that is nothing unknown: instruments are linear to so much.
    equations : float
        Share of what its effects do, that a model's equations may be wrong by.
    most_noise : float
        Share of the response's energy that may be noise to the most probable model, for effects to
        be named or spoken of: with more, what the joint does may have been taken for noise.
    most_effects : int
        Most effects to add.
    """

    claimed: float = 0.95
    decisive_kind: float = 5.0
    discrepancy: float = 1e-3
    most_slack: float = 0.3
    explained_share: float = 0.5
    resolved: float = 20.0
    kind_share: float = 0.8
    trace_share: float = 0.01
    clear_latency: float = 0.1
    least_latency: float = 0.01
    notable: float = 3.0
    enough_noise: float = 1.5
    loose: float = 0.5
    noise_draws: int = 10
    false_discoveries: float = 0.05
    solver_share: float = scheme.SHARE
    solver_most: float = scheme.MOST
    solver_least: float = scheme.LEAST
    solver_nats: float = 0.5
    trifle: float = 3e-3
    equations: float = 0.1
    most_noise: float = 0.5
    most_effects: int = 4
