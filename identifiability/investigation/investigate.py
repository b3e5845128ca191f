"""The whole way from trials to a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.errors import InputError
from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.kept import Kept
from identifiability.investigation.ladder.found import Found
from identifiability.investigation.next_experiment import Limits
from identifiability.investigation.rules import Rules
from identifiability.investigation.session import Investigation
from identifiability.investigation.verdict.judge import UNDECIDED
from identifiability.joint.effects import Effect
from identifiability.joint.model import Model
from identifiability.measurement.filtering import Lowpass
from identifiability.measurement.trials import Trial
from identifiability.progress import Progress, silent

T = TypeVar("T")


def investigate(
    trials: Sequence[Trial],
    held_out: Sequence[Trial] = (),
    *,
    model: Model | None = None,
    library: Mapping[str, type[Effect]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    lowpass_hz: Lowpass = "auto",
    rules: Rules | None = None,
    limits: Limits | None = None,
    most: int | None = None,
    with_widths: bool = True,
    seed: int = 1,
    kept: Kept | None = None,
    progress: Progress = silent,
) -> Findings:
    """Find out what a joint model misses in recorded trials.

    Parameters
    ----------
    trials, held_out, model, library, bounds, lowpass_hz, rules, kept, progress
        See `Investigation`.
    limits : Limits, optional
        Of the next experiment; those that the trials kept by default.
    most : int, optional
        Most effects to add; the rules' number by default.
    with_widths : bool
        Whether to compute the widths of the final model's parameters.
    seed : int

    Returns
    -------
    Findings

    Raises
    ------
    InputError
        Where the trials cannot be investigated.
    """
    study = Investigation(
        trials,
        held_out,
        model=model,
        library=library,
        bounds=bounds,
        lowpass_hz=lowpass_hz,
        rules=rules,
        kept=kept,
        progress=progress,
    )
    return _investigated(
        study, limits=limits, most=most, with_widths=with_widths, seed=seed, progress=progress
    )


def _investigated(
    study: Investigation,
    *,
    limits: Limits | None,
    most: int | None,
    with_widths: bool,
    seed: int,
    progress: Progress,
    as_it_is: bool = False,
) -> Findings:
    """The same of trials that are ready; those with the torque `as_it_is` between samples."""
    failures: dict[str, str] = {}
    timings: dict[str, float] = {}

    @contextmanager
    def timed(part: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        timings[part] = time.perf_counter() - began

    def attempt(what: str, work: Callable[[], T]) -> T | None:
        # One part that fails must not take the others with it; the findings say that it failed.
        try:
            return work()
        except (InputError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            failures[what] = str(error)
            return None

    # What needs much Python runs beside the compiler and its programs. One thread for the linear
    # algebra of small matrices: then the order of its sums does not depend on what runs beside.
    with threadpool_limits(1), ThreadPoolExecutor(1) as aside:
        progress("fitting the baseline", 0, 1)
        with timed("baseline"):
            first = study.baseline
        progress("comparing", 0, 1)
        with timed("comparison"):
            comparison = attempt("comparison", lambda: study.compare(first))
            location = attempt("location", lambda: study.locate(first))
        unexplained_before = aside.submit(
            attempt, "unexplained torque", lambda: study.unexplained(first, seed=seed)
        )
        with timed("probabilities"):
            posterior = attempt("probabilities", lambda: study.weigh(most=most, seed=seed))
            other = None
            if posterior is not None and not as_it_is:
                other = attempt(
                    "torque between the samples", lambda: study.otherwise(posterior, seed=seed)
                )
        if other is not None:
            unexplained_before.cancel()
            progress(f"once more, the torque {other.torque_between} between its samples", 0, 1)
            return _investigated(
                other,
                limits=limits,
                most=most,
                with_widths=with_widths,
                seed=seed,
                progress=progress,
                as_it_is=True,
            )
        claimed = study.claim(posterior).kind if posterior is not None else ""
        nested = None
        if posterior is not None and claimed == "effects":
            with timed("choice without what is held out"):
                nested = attempt(
                    "choice without what is held out",
                    lambda: study.weigh_nested(posterior, seed=seed),
                )
        with timed("error ladder"):
            found = study.climb(posterior) if posterior else Found.nothing(first)
            if found.failure:
                failures["error ladder"] = found.failure
        final, sought = found.final, None
        if with_widths:
            progress("widths of the parameters", 0, 1)
            sought = aside.submit(attempt, "widths", lambda: study.widths(final, seed=seed))
        progress("what is left", 0, 1)
        with timed("what is left"):
            before = unexplained_before.result()
            after = before if final is first else None
            after = study.unexplained(final, seed=seed) if after is None else after
        with timed("rest of the widths"):
            widths = None if sought is None else sought.result()
        lower = None if widths is None else study.lower(final, widths)
        if posterior is not None and lower is not None:
            progress("what is left, from a lower optimum", 0, 1)
            with timed("what is left, from a lower optimum"):
                found = study.climb(posterior, also=lower)
                after = study.unexplained(found.final, seed=seed)
        seen = None
        if claimed == "nothing":
            with timed("smallest effects seen"):
                seen = attempt(
                    "smallest effects seen", lambda: study.smallest_seen(found.final, seed=seed)
                )
        verdict = UNDECIDED
        if posterior is not None:
            verdict = study.judge(posterior, found, after, seen or (), nested)
        progress("the next experiment", 0, 1)
        with timed("next experiment"):
            following = attempt(
                "next experiment",
                lambda: study.next_experiment(found, verdict, limits=limits, seed=seed),
            )
    return Findings(
        study.split,
        found,
        comparison,
        location,
        before,
        after,
        widths,
        verdict,
        following,
        study.library,
        failures,
        study.remarks,
        seed,
        posterior,
        timings,
    )
