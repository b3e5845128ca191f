"""A joint's model, built effect by effect, that one can go back and forth in."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Self

from threadpoolctl import threadpool_limits

from identifiability.errors import InputError
from identifiability.inference.between import Between
from identifiability.inference.widths import Widths
from identifiability.investigation.fits.candidate import unfitted
from identifiability.investigation.fits.kept import OnDisk
from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.posterior.jobs import enlarged, richer
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.posterior.weighing import Job, Weighing
from identifiability.investigation.rules import Rules
from identifiability.investigation.session import Investigation, evaluations_of
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.where.compare import Comparison
from identifiability.investigation.where.locate import Location
from identifiability.investigation.wording.verdict import model_in_words
from identifiability.joint.effects import EFFECTS, Effect
from identifiability.joint.model import KBI, Model
from identifiability.joint.programs import THREADS
from identifiability.measurement.filtering import Lowpass
from identifiability.measurement.trials import Trial
from identifiability.progress import Progress, silent
from identifiability.workbench.attempt import Attempt, Ranked, Ranking
from identifiability.workbench.difference import Difference
from identifiability.workbench.moves import (
    FITS,
    Move,
    holds_session,
    read_session,
    write_moves,
    write_trials,
)
from identifiability.workbench.notebook import show_in_notebooks

Keys = tuple[str, ...]


class Session:
    """An investigation that is steered by hand.

    The model starts as K, B and I; `rank` says what one effect more would bring, `add` and `drop`
    change it, `undo` and `redo` go back and forth. Whatever was fitted is kept and never fitted
    again, on disk where there is a folder.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    held_out : sequence of Trial
        Trials that no model is fitted to; chosen by itself if empty.
    model : Model, optional
        The model to start from; ``KBI()`` by default.
    library : mapping of str to type of Effect, optional
        Effects that may be added; the registry's by default.
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    lowpass_hz : float, "auto" or None
    torque_between : {"auto", "straight", "smooth"}
        See `Investigation`.
    rules : Rules, optional
        Conventions.
    seed : int
        Of the probes by which noise of an imposed angle is taken off, and of random waveforms.
    folder : Path, optional
        Where the session is kept as it goes on.
    moves : sequence of tuple of str, optional
        What was done before, as `Session.open` reads it: it is done again.
    progress : callable
        Told ``(what, done, total)``.

    Raises
    ------
    InputError
        If the folder holds a session already.

    Examples
    --------
    >>> from identifiability import EFFECTS, Session, example_trials
    >>> few = {key: EFFECTS[key] for key in ("series_tendon", "cubic_stiffness")}
    >>> session = Session(example_trials(), library=few)
    >>> for one in session.rank():  # each as it lands; stop when you like
    ...     print(one)
    + series tendon: +78... nats; K, B, I + series tendon: E = 0.00013..., 0.00014... held out
    + cubic stiffness: ... nats; K, B, I + cubic stiffness: E = ... held out
    >>> session.add("series_tendon")
    K, B, I + series tendon: E = 0.00013..., 0.00014... held out
    >>> session.compare(session.history[0])
    K, B, I + series tendon is more probable than K, B, I: more than 99.9 %, if one of the two ...
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        held_out: Sequence[Trial] = (),
        *,
        model: Model | None = None,
        library: Mapping[str, type[Effect]] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        lowpass_hz: Lowpass = "auto",
        torque_between: Between = "auto",
        rules: Rules | None = None,
        seed: int = 1,
        folder: Path | str | None = None,
        moves: Sequence[Move] | None = None,
        progress: Progress = silent,
    ) -> None:
        show_in_notebooks()
        self.folder = None if folder is None else Path(folder)
        if self.folder is not None and moves is None and holds_session(self.folder):
            raise InputError(f"{folder} holds a session already: Session.open({str(folder)!r})")
        home = self.folder
        if home is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="identifiability-")
            home = Path(self._temporary.name)
        self._fits = home / FITS
        self.study = Investigation(
            trials,
            held_out,
            model=model,
            library=library,
            bounds=bounds,
            lowpass_hz=lowpass_hz,
            torque_between=torque_between,
            rules=rules,
            kept=OnDisk(self._fits),
            progress=progress,
        )
        self.seed = seed
        self._recorded = tuple(trials), tuple(held_out)
        self._how = {
            "model": list((KBI() if model is None else model).effect_keys),
            "bounds": {name: list(pair) for name, pair in (bounds or {}).items()},
            "lowpass_hz": lowpass_hz,
            "torque_between": torque_between,
            "rules": asdict(self.study.bench.rules),
            "seed": seed,
        }
        self._moves: list[Move] = []
        self._states: list[Keys] = [()]
        self._place = 0
        self._pinned: list[Keys] = []
        self._attempts: dict[Keys, Attempt] = {}
        if moves is not None:
            self._repeat(moves)
        elif self.folder is not None:
            write_trials(self.folder, *self._recorded)
            self._write()

    # Where it is

    @property
    def now(self) -> Attempt:
        """The present model."""
        return self._attempt(self._states[self._place])

    @property
    def model(self) -> Model:
        """That of now."""
        return self.now.model

    @property
    def history(self) -> tuple[Attempt, ...]:
        """Every model from the first to the last, those that were undone too."""
        return tuple(self._attempt(keys) for keys in self._states)

    @property
    def place(self) -> int:
        """Number of the present model in the history."""
        return self._place

    @property
    def pinned(self) -> tuple[Attempt, ...]:
        """Models that were set aside, to be compared with."""
        return tuple(self._attempt(keys) for keys in self._pinned)

    @property
    def ranking(self) -> Ranking:
        """What was ranked beside the present model, what brings most first."""
        keys = self._states[self._place]
        known = (
            self._ranked(keys, key)
            for key in self._addable(keys)
            if self._name(keys, key) in self._tried
        )
        return Ranking(sorted(known, key=lambda one: -one.gained))

    # Look

    def locate(self) -> Location:
        """Where the present model fails."""
        return self.study.locate(self.now.candidate)

    def constancy(self) -> Comparison:
        """How well the present model fits, and whether K, B and I are constants in it."""
        return self.study.compare(self.now.candidate)

    def unexplained(self) -> Unexplained:
        """What the present model leaves, as a torque of which nothing is assumed but its family."""
        return self.study.unexplained(self.now.candidate, seed=self.seed)

    def widths(self, attempt: Attempt | None = None) -> Widths:
        """How well the parameters of a model are known, by every kind of width.

        Parameters
        ----------
        attempt : Attempt, optional
            The present model by default.
        """
        one = self.now if attempt is None else attempt
        return self.study.widths(one.candidate, seed=self.seed)

    # Move

    def rank(self, *keys: str) -> Iterator[Ranked]:
        """Weigh every effect beside the present model, and yield each as it lands.

        Parameters
        ----------
        *keys : str
            Effects; by default all that may be added.

        Yields
        ------
        Ranked
            In the order of the library; `ranking` has them in that of what they bring.

        Raises
        ------
        InputError
            Where an effect is not known, or part of the model already.
        """
        current = self._states[self._place]
        for key in keys:
            self._require_addable(current, key)
        waiting = iter(keys or self._addable(current))
        done, total = 0, len(keys or self._addable(current))
        # So many at a time, that nothing goes on where this is stopped.
        while part := tuple(islice(waiting, THREADS)):
            new = [key for key in part if self._name(current, key) not in self._tried]
            self._rank(current, part)
            if new:
                self._moved("rank", *new)
            for key in part:
                done += 1
                self.study.progress("ranking", done, total)
                yield self._ranked(current, key)

    def add(self, *keys: str) -> Attempt:
        """Add effects to the model, in richer form too where that is more probable.

        Parameters
        ----------
        *keys : str

        Raises
        ------
        InputError
            Where an effect is not known, is part of the model already, or cannot be fitted; then
            the model stays as it was.
        """
        current = self._states[self._place]
        for key in keys:
            self._require_addable(current, key)
            self._rank(current, (key,))
            name = self._name(current, key)
            if name not in self._weighing.found:
                raise InputError(f"{key} cannot be added: {self._failure(name)}")
            self._finish(name)
            current = (*current, key)
            self._attempt(current)
        self._go(current)
        self._moved("add", *keys)
        return self.now

    def drop(self, *keys: str) -> Attempt:
        """Leave effects out of the model.

        Parameters
        ----------
        *keys : str

        Raises
        ------
        InputError
            Where an effect is not one that was added, or what is left cannot be fitted.
        """
        current = self._states[self._place]
        for key in keys:
            if key not in current:
                added = ", ".join(current) or "nothing"
                raise InputError(f"{key} was not added: what can be dropped is {added}")
        larger = self._weighing.found[tuple(sorted(current))]
        rest = tuple(k for k in current if k not in keys)
        name = tuple(sorted(rest))
        if name not in self._weighing.found:
            model = self.study.model.plus(larger.model.effect(key) for key in rest)
            start = {n: larger.values[n] for n in model.parameter_names}
            forms = model.refinable(larger.refined)
            self._weigh([Job(model, [start], forms, larger.weights)])
            if name not in self._weighing.found:
                raise InputError(f"the model without {', '.join(keys)}: {self._failure(name)}")
        self._finish(name)
        self._attempt(rest)
        self._go(rest)
        self._moved("drop", *keys)
        return self.now

    def undo(self) -> Attempt:
        """Go back by one model.

        Raises
        ------
        InputError
            At the first.
        """
        return self._to(self._place - 1, "undo")

    def redo(self) -> Attempt:
        """Go forth by one model.

        Raises
        ------
        InputError
            At the last.
        """
        return self._to(self._place + 1, "redo")

    def pin(self) -> Attempt:
        """Set the present model aside, to compare others with it."""
        keys = self._states[self._place]
        if keys not in self._pinned:
            self._pinned.append(keys)
            self._moved("pin")
        return self.now

    # Judge

    def compare(self, first: Attempt, second: Attempt | None = None) -> Difference:
        """Two models side by side.

        Parameters
        ----------
        first : Attempt
        second : Attempt, optional
            The present one by default.
        """
        second = self.now if second is None else second
        prior = self._weighing.together.log_prior
        nats = first.log_evidence + prior(len(first.added))
        nats -= second.log_evidence + prior(len(second.added))
        return Difference(first, second, nats, self.study)

    def probabilities(self) -> Probabilities:
        """Probabilities of the sets that were tried, "nothing" and "something unknown" among them.

        Of those alone: what was not ranked has none. `search` tries the others.
        """
        with threadpool_limits(limits=1):
            return self._weighing.concluded()

    def search(self) -> Probabilities:
        """Probabilities as `investigate` finds them: it decides by itself what to try.

        And how an imposed torque ran between its samples; a session keeps to its `torque_between`.
        """
        return self.study.likeliest(seed=self.seed).weigh(seed=self.seed)

    def claim(self, found: Probabilities) -> Claim:
        """What probabilities allow to name."""
        return self.study.claim(found)

    # Keep

    def save(self, folder: Path | str) -> None:
        """Write the session as it is now into a folder, with all its fits.

        Parameters
        ----------
        folder : Path or str
        """
        folder = Path(folder)
        if folder != self.folder:
            shutil.copytree(self._fits, folder / FITS, dirs_exist_ok=True)
            write_trials(folder, *self._recorded)
        write_moves(folder, self._how, self._moves)

    @classmethod
    def open(
        cls,
        folder: Path | str,
        *,
        library: Mapping[str, type[Effect]] | None = None,
        progress: Progress = silent,
    ) -> Self:
        """Open a session where it was left; nothing that this code fitted is fitted again.

        Parameters
        ----------
        folder : Path or str
        library : mapping of str to type of Effect, optional
            Effects that may be added, where it has some of your own.
        progress : callable
            Told ``(what, done, total)``.

        Raises
        ------
        InputError
            If the folder holds no session, or one with effects that the library has not.
        """
        stored = read_session(Path(folder))
        how: dict[str, Any] = dict(stored.how)
        known = EFFECTS if library is None else library
        used = {*how.pop("model"), *(k for move in stored.moves for k in move[1:])}
        if missing := sorted(used - set(known)):
            raise InputError(
                f"the session has effects that the library has not ({', '.join(missing)}): give "
                "Session.open a library with them"
            )
        how["bounds"] = {name: tuple(pair) for name, pair in how["bounds"].items()}
        how["rules"] = Rules(**how["rules"])
        return cls(
            stored.trials,
            stored.held_out,
            model=KBI().plus(known[key]() for key in stored.how["model"]),
            library=library,
            folder=folder,
            moves=stored.moves,
            progress=progress,
            **how,
        )

    def _repeat(self, moves: Sequence[Move]) -> None:
        """Do again what was done; only then the folder may be written to."""
        folder, self.folder = self.folder, None
        for i, (what, *keys) in enumerate(moves):
            self.study.progress("opening the session", i, len(moves))
            if what == "rank":
                list(self.rank(*keys))
            else:
                getattr(self, what)(*keys)
        self.folder = folder

    # What it is made of

    @cached_property
    def _weighing(self) -> Weighing:
        """What was weighed: K, B and I alone at first."""
        study, base = self.study, self.study.baseline
        if base.failure:
            raise InputError(f"the model to start from cannot be fitted: {base.failure}")
        kept = evaluations_of(study, self.seed)
        weighing = Weighing(
            kept.evaluator, study.library, base.keys, study.bench.rules, study.progress, kept
        )
        with threadpool_limits(limits=1):
            list(weighing.weigh([Job(base.model, [base.values], base.refined)]))
        weighing.require_base()
        return weighing

    @property
    def _tried(self) -> set[Keys]:
        failed = {tuple(sorted(filter(None, name.split("+")))) for name in self._weighing.failures}
        return {*self._weighing.found, *failed}

    @staticmethod
    def _name(keys: Keys, key: str) -> Keys:
        return tuple(sorted((*keys, key)))

    def _failure(self, name: Keys) -> str:
        return self._weighing.failures.get("+".join(name), "it has no fit")

    def _addable(self, keys: Keys) -> Keys:
        """Effects that a model has not."""
        has = {*self.study.baseline.keys, *keys}
        return tuple(key for key in self.study.library if key not in has)

    def _require_addable(self, keys: Keys, key: str) -> None:
        if key not in self.study.library:
            known = ", ".join(self.study.library)
            raise InputError(f"{key!r} is no effect of the library: the effects are {known}")
        if key not in self._addable(keys):
            raise InputError(f"{key} is part of the model already")

    def _weigh(self, jobs: Sequence[Job]) -> None:
        with threadpool_limits(limits=1):
            list(self._weighing.weigh(jobs))

    def _rank(self, current: Keys, keys: Keys) -> None:
        """Weigh effects beside a model, as far as they were not."""
        found, library = self._weighing.found, self.study.library
        now = found[tuple(sorted(current))]
        jobs = []
        for key in keys:
            if self._name(current, key) in self._tried:
                continue
            alone = found[key,].values if (key,) in found else {}
            try:
                jobs.append(enlarged(now, library[key](), alone))
            except InputError as error:  # it does not go with an effect that is there
                self._weighing.failures["+".join(self._name(current, key))] = str(error)
        self._weigh(jobs)

    def _finish(self, name: Keys) -> None:
        """Weigh a model in richer forms too, and in steps that are short enough."""
        if self._weighing.taken_up.get(name) is self._weighing.found[name]:
            return
        self._weigh(richer(self._weighing.found[name], name))
        with threadpool_limits(limits=1):
            self._weighing.take_up([name])
        if name not in self._weighing.found:
            raise InputError(f"{model_in_words(name)} has no evidence: {self._failure(name)}")
        self._attempts = {k: a for k, a in self._attempts.items() if tuple(sorted(k)) != name}

    def _ranked(self, current: Keys, key: str) -> Ranked:
        name, found = self._name(current, key), self._weighing.found
        if name not in found:
            return Ranked(key, float("-inf"), None, self._failure(name))
        gained = found[name].log_evidence - found[tuple(sorted(current))].log_evidence
        attempt = self._attempt((*current, key))
        if attempt.candidate.failure:
            return Ranked(key, float("-inf"), None, attempt.candidate.failure)
        return Ranked(key, gained, attempt)

    def _attempt(self, keys: Keys) -> Attempt:
        """A model with some effects, fitted by least squares from where it was weighed."""
        if keys not in self._attempts:
            found = self._weighing.found[tuple(sorted(keys))]
            start = unfitted(found.model, found.values, found.refined, found.scheme)
            fitted = self.study.bench.finish(start)
            self._attempts[keys] = Attempt(
                keys, fitted, found.log_evidence, found.sds, self.study.split
            )
        return self._attempts[keys]

    def _go(self, keys: Keys) -> None:
        """Go to another model; what was undone is no more."""
        self._states = [*self._states[: self._place + 1], keys]
        self._place += 1

    def _to(self, place: int, what: str) -> Attempt:
        if not 0 <= place < len(self._states):
            raise InputError(f"there is nothing to {what}")
        self._place = place
        self._moved(what)
        return self.now

    def _moved(self, what: str, *keys: str) -> None:
        self._moves.append((what, *keys))
        self._write()

    def _write(self) -> None:
        if self.folder is not None:
            write_moves(self.folder, self._how, self._moves)

    def __repr__(self) -> str:
        lines = [
            f"{'>' if i == self._place else ' '} {attempt!r}"
            for i, attempt in enumerate(self.history)
        ]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from identifiability.workbench.show import page

        return page(self)
