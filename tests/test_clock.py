"""How far a command says it is."""

import io
import time

import pytest

from identifiability.cli import clock as module


class Terminal(io.StringIO):
    def __init__(self, terminal):
        super().__init__()
        self.terminal = terminal

    def isatty(self):
        return self.terminal


@pytest.fixture
def said(monkeypatch):
    """What is said at given times, on a terminal or in a file."""

    def of(steps, *, terminal, name=""):
        times = iter([0.0, *(at for at, *_ in steps)])
        monkeypatch.setattr(module.time, "monotonic", lambda: next(times))
        out = Terminal(terminal)
        monkeypatch.setattr("sys.stderr", out)
        announce = module.Clock(name)
        for _, *told in steps:
            announce(*told)
        return out.getvalue()

    return of


STEPS = [
    (1, "fitting", 1, 1),
    (2, "weighing", 1, 5),
    (12, "weighing", 2, 5),
    (22, "weighing", 3, 5),
]


def test_each_step_is_a_line_with_the_time_that_is_left(said):
    assert said(STEPS, terminal=False).splitlines() == [
        "[    1 s] fitting",
        "[    2 s] weighing 1/5",
        "[   12 s] weighing 2/5, 30 s left of this",
        "[   22 s] weighing 3/5, 20 s left of this",
    ]


def test_on_a_terminal_it_is_one_line(said):
    text = said(STEPS, terminal=True, name="ankle")
    assert "\n" not in text
    assert text.count("\r\x1b[K") == len(STEPS)
    assert text.endswith("[   22 s] ankle: weighing 3/5, 20 s left of this")


def test_lines_of_one_step_are_told_apart_and_the_last_is_said(said):
    steps = [(1.0, "weighing", 1, 3), (1.01, "weighing", 2, 3), (1.02, "weighing", 3, 3)]
    lines = said(steps, terminal=False).splitlines()
    assert [line.split()[-1] for line in lines] == ["1/3", "3/3"]


def test_what_says_nothing_for_long_is_said_to_be_at_work(monkeypatch):
    monkeypatch.setattr(module, "_SILENCE", 0.02)
    out = Terminal(False)
    monkeypatch.setattr("sys.stderr", out)
    with module.Clock("ankle") as announce:
        time.sleep(0.1)
        assert out.getvalue() == ""  # nothing has begun
        announce("weighing", 2, 5)
        deadline = time.monotonic() + 10
        while out.getvalue().count("\n") < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    said = out.getvalue().splitlines()
    assert said[0].endswith("ankle: weighing 2/5")
    assert all(line.endswith("ankle: weighing 2/5, at work") for line in said[1:3])
    time.sleep(0.1)
    assert out.getvalue().splitlines() == said  # left, it says no more
