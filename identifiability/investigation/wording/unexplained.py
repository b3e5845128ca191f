"""What a model leaves, in a sentence."""

from __future__ import annotations

from identifiability.investigation.unexplained.account import Unexplained

KINDS = {
    "none": "noise",
    "drift": "a drift of the recording",
    "sensor": "a filter or delay in the recording",
    "static": "a torque of the present angle and velocity",
    "hysteresis": "a torque like dry friction",
    "memory": "a torque of the past motion",
    "unrepeatable": "a torque that no one function of the motion makes",
}
"""Kinds of what may be missing, in words."""

_IT = {
    "drift": "is a slow drift of the recording",
    "sensor": "looks as if the recording were filtered or delayed",
    "static": "behaves like a torque that depends on the present angle and velocity",
    "hysteresis": (
        "behaves like dry friction or a yielding element: a torque that depends on how far the "
        "joint has moved since it turned back"
    ),
    "memory": "behaves like a torque that depends on the past motion",
    "unrepeatable": (
        "is a torque that no one function of the motion makes: it differs from trial to trial, or "
        "changes with time"
    ),
}
_MAINLY = {
    "variation": "behaves like stiffness and damping that change from trial to trial",
    "varying": "behaves like stiffness and damping that change during the trials",
}
_SHORTEST = 2e-3  # s, of a time constant that is told from none
_ONE_WAY = {
    "memory_positive": ", and to motion in the positive direction only",
    "memory_negative": ", and to motion in the negative direction only",
}


def unexplained_sentence(rest: Unexplained) -> str:
    """What kind of thing is left, in one sentence."""
    best = rest.best
    if not rest.decided:
        return (
            f"What is left could be {KINDS[best.kind]} or {KINDS[rest.rival.kind]}: these data do "
            "not tell them apart."
        )
    if best.kind == "none":
        if rest.noise_suffices:
            return "What is left is noise: nothing in it depends on the motion or repeats."
        return (
            f"What is left looks like noise, but of {rest.noise_ratio:.1f} times the size it has "
            "before the perturbation."
        )
    main = max(best.shares, key=lambda key: best.shares[key])
    words = f"What is left {_MAINLY.get(main, _IT[best.kind])}{_pace(rest)}{_ONE_WAY.get(main, '')}"
    if best.kind == "unrepeatable":
        return f"{words}."
    return f"{words}; that explains {100 * rest.share:.0f} % of it beyond the noise."


def _pace(rest: Unexplained) -> str:
    """Latency of a torque of the past motion, or how fast it fades."""
    if rest.best.kind != "memory" or rest.delay_readout is None:
        return ""
    if rest.latency is not None:
        return f", with a latency of about {1000 * rest.latency:.0f} ms"
    decay = rest.delay_readout.decay
    if decay < _SHORTEST:
        return ", and fades within a few milliseconds"
    return f", and fades with a time constant of about {1000 * decay:.0f} ms"
