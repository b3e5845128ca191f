import contextlib
import hashlib
import math
import os
import signal
import time
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import io

from identifiability.errors import InputError
from identifiability.measurement.readers import apart, extras, matlab
from identifiability.measurement.readers.columns import parse_columns
from identifiability.measurement.readers.formats import READERS, readable_files
from identifiability.measurement.readers.tables import Table
from identifiability.measurement.readers.trial_file import read_trial
from identifiability.measurement.trials import Trial, onsets, quiet_lead
from identifiability.measurement.units import parse_unit

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL = DATA / "real"
needs_real = pytest.mark.skipif(not REAL.is_dir(), reason="needs ../shared/data/real")

TIME = np.arange(40) * 1e-3
TORQUE = np.round(3.0 * np.sin(np.arange(40) / 5.0), 6)
ANGLE = np.round(0.1 * np.cos(np.arange(40) / 7.0), 6)
BY_INDEX = {"time": (0, "s"), "torque": (1, "Nm"), "angle": (2, "rad")}


def text_of(*columns, header="time_s,torque_Nm,angle_rad", separator=",", decimal="."):
    rows = [separator.join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
    if decimal == ",":
        rows = [row.replace(".", ",") for row in rows]
    return "\n".join([header, *rows] if header else rows) + "\n"


def written(folder, text, name="trial.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def assert_same(trial, torque=TORQUE, angle=ANGLE):
    np.testing.assert_allclose(trial.time, TIME, atol=1e-12)
    np.testing.assert_allclose(trial.torque, torque, atol=1e-12)
    np.testing.assert_allclose(trial.angle, angle, atol=1e-12)


# Units


@pytest.mark.parametrize(
    ("text", "quantity", "factor"),
    [
        ("s", "time", 1.0),
        ("ms", "time", 1e-3),
        ("µs", "time", 1e-6),
        ("μs", "time", 1e-6),
        ("min", "time", 60.0),
        ("rad", "angle", 1.0),
        ("mrad", "angle", 1e-3),
        ("°", "angle", math.pi / 180),
        ("Degrees", "angle", math.pi / 180),
        (" deg ", "angle", math.pi / 180),
        *((text, "torque", 1.0) for text in ("Nm", "N.m", "N*m", "N-m", "N m", "N_m", "N·m", "NM")),
        ("nm", "torque", 1.0),
        ("mNm", "torque", 1e-3),
        ("mN m", "torque", 1e-3),
        ("Nmm", "torque", 1e-3),
        ("N.mm", "torque", 1e-3),
        ("Ncm", "torque", 1e-2),
        ("kN.m", "torque", 1e3),
    ],
)
def test_spellings_of_units(text, quantity, factor):
    assert parse_unit(text, quantity) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "quantity", "sentence"),
    [
        ("Nm", "angle", "'Nm' is a unit of torque, where a unit of angle is needed.*rad, .*deg"),
        ("deg", "time", "'deg' is a unit of angle, where a unit of time"),
        ("furlong", "torque", "unit 'furlong' of torque is not known: write one of Nm, mNm"),
        ("", "angle", "unit '' of angle is not known"),
        ("MNm", "torque", "'MNm' of torque is not known"),  # mega, never milli
        ("MS", "time", "'MS' of time is not known"),
        ("rad/s", "angle", "'rad/s' of angle is not known"),
    ],
)
def test_units_that_are_refused(text, quantity, sentence):
    with pytest.raises(InputError, match=sentence):
        parse_unit(text, quantity)


# Columns from the command line


def test_columns_by_name_and_by_index():
    texts = ["time=time:s", "angle=position:deg", "torque=1:N.m"]
    assert parse_columns(texts) == {
        "time": ("time", "s"),
        "angle": ("position", "deg"),
        "torque": (1, "N.m"),
    }
    assert parse_columns(["angle=a=b:c:rad"]) == {"angle": ("a=b:c", "rad")}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("angle", "'angle' does not name a column: write quantity=column:unit"),
        ("angle=position", "does not name a column"),
        ("angle=:rad", "does not name a column"),
        ("force=1:Nm", "'force' is not a quantity"),
        ("angle=1:Nm", "'Nm' is a unit of torque"),
        ("angle=1:cubit", "unit 'cubit' of angle is not known"),
    ],
)
def test_column_texts_that_are_refused(text, sentence):
    with pytest.raises(InputError, match=sentence):
        parse_columns([text])


def test_a_quantity_named_twice_is_refused():
    with pytest.raises(InputError, match="column of angle is named twice"):
        parse_columns(["angle=1:rad", "angle=2:rad"])


# Text files


@pytest.mark.parametrize(
    ("separator", "decimal"),
    [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), ("  ", ",")],
)
@pytest.mark.parametrize("with_header", [True, False])
def test_separators_and_decimal_marks(tmp_path, separator, decimal, with_header):
    header = separator.join(["time_s", "torque_Nm", "angle_rad"]) if with_header else ""
    text = text_of(TIME, TORQUE, ANGLE, header=header, separator=separator, decimal=decimal)
    path = written(tmp_path, text, "walk.txt")
    trial = read_trial(path, columns=None if with_header else BY_INDEX)
    assert_same(trial)
    assert (trial.name, trial.source, trial.notes) == ("walk", "walk.txt", ())
    assert trial.sha256 == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(
    "header",
    [
        "time_s,torque_Nm,angle_rad",
        "Time (s),Ankle torque (N.m),Ankle angle (rad)",
        "t [s],tau [N m],theta [rad]",
        "Time/s,Torque/Nm,Angle/rad",
        '"time s","moment_N_m","position rad"',
        "time_s,kneeTorque_Nm,kneeAngle_rad",
    ],
)
def test_headers_with_units(tmp_path, header):
    assert_same(read_trial(written(tmp_path, text_of(TIME, TORQUE, ANGLE, header=header))))


def test_units_are_converted(tmp_path):
    header = "time_ms,torque (mNm),angle [deg]"
    text = text_of(TIME * 1e3, TORQUE * 1e3, np.degrees(ANGLE), header=header)
    assert_same(read_trial(written(tmp_path, text)))


def test_other_columns_do_not_disturb(tmp_path):
    header = "velocity_rad_s,phase,time_s,angle_rad,torque_Nm"
    lines = [f"{q},hold,{t},{q},{u}" for t, u, q in zip(TIME, TORQUE, ANGLE, strict=True)]
    lines[3] = f"nan,,{TIME[3]},{ANGLE[3]},{TORQUE[3]}"
    assert_same(read_trial(written(tmp_path, "\n".join([header, *lines]))))


@pytest.mark.parametrize(
    "disguise",
    [
        lambda text: b"\xef\xbb\xbf" + text.encode(),
        lambda text: text.encode("utf-16"),
        lambda text: text.replace("\n", "\r\n").encode(),
        lambda text: ("# measured on Monday, at 3\n\n" + text + "# the end\n\n").encode(),
        lambda text: text.replace("\n", ",\n").encode(),
        lambda text: text.replace(",", " , ").encode(),
    ],
    ids=["BOM", "UTF-16", "CRLF", "comments", "trailing separator", "padding"],
)
def test_disguises_of_a_text_file(tmp_path, disguise):
    assert_same(read_trial(written(tmp_path, disguise(text_of(TIME, TORQUE, ANGLE)))))


def test_a_degree_sign_in_latin_1(tmp_path):
    text = text_of(TIME, TORQUE, np.degrees(ANGLE), header="time_s,torque_Nm,angle (°)")
    assert_same(read_trial(written(tmp_path, text.encode("latin-1"))))


def test_rate_in_place_of_time(tmp_path):
    path = written(tmp_path, text_of(TORQUE, ANGLE, header="torque_Nm,angle_rad"))
    assert_same(read_trial(path, rate=1000.0))
    assert_same(read_trial(written(tmp_path, text_of(TIME, TORQUE, ANGLE)), rate=1005.0))


def test_restoring_torque_changes_sign(tmp_path):
    path = written(tmp_path, text_of(TIME, -TORQUE, ANGLE))
    trial = read_trial(path, restoring=True, name="knee", driven="angle")
    assert_same(trial)
    assert (trial.name, trial.driven) == ("knee", "angle")
    assert "sign of torque changed" in trial.notes[-1]


def test_a_rounded_clock_is_taken_as_even(tmp_path):
    time = np.arange(400) / 610.35
    wave = np.sin(20 * time)
    trial = read_trial(written(tmp_path, text_of(np.round(time, 6), wave, 0.1 * wave)))
    np.testing.assert_array_equal(trial.torque, wave)
    assert trial.sampling_rate == pytest.approx(610.35, rel=1e-5)
    assert "rounding of time undone" in trial.notes[0]


def test_a_clock_that_counts_from_1970(tmp_path):
    trial = read_trial(written(tmp_path, text_of(1.7e9 + TIME, TORQUE, ANGLE)))
    np.testing.assert_allclose(trial.time, TIME, atol=1e-6)
    np.testing.assert_array_equal(trial.angle, ANGLE)
    assert "time counted from 1700000000 s" in trial.notes[0]


def test_jitter_of_the_clock_is_resampled(tmp_path):
    rng = np.random.default_rng(0)
    steps = 2e-3 * (1.0 + 0.02 * rng.uniform(-1, 1, 999))
    time = np.concatenate([[0.0], np.cumsum(steps)])
    path = written(tmp_path, text_of(time, np.sin(9 * time), 0.1 * np.cos(7 * time)))
    trial = read_trial(path)
    assert trial.dt == pytest.approx(np.median(steps), rel=1e-9)
    np.testing.assert_allclose(trial.torque, np.sin(9 * trial.time), atol=1e-4)
    np.testing.assert_allclose(trial.angle, 0.1 * np.cos(7 * trial.time), atol=1e-5)
    assert "time steps varied by 2" in trial.notes[0]


def late(gap, every):
    """Time of samples 2 ms apart, of which one in so many is late."""
    steps = np.full(2000, 2e-3)
    steps[every // 2 :: every] *= gap
    return np.concatenate([[0.0], np.cumsum(steps)])


def swung(tmp_path, time, **options):
    path = written(tmp_path, text_of(time, np.sin(9 * time), 0.1 * np.cos(7 * time)))
    return read_trial(path, **options)


def test_a_logger_that_is_late_now_and_then_is_resampled_and_it_is_said(tmp_path):
    trial = swung(tmp_path, late(1.6, 400))
    assert trial.dt == pytest.approx(2e-3)
    np.testing.assert_allclose(trial.torque, np.sin(9 * trial.time), atol=1e-3)
    np.testing.assert_allclose(trial.angle, 0.1 * np.cos(7 * trial.time), atol=1e-5)
    assert "5 of 2000 time steps differ by 5 % or more, the longest is 1.6" in trial.notes[0]


def test_one_that_is_late_often_is_resampled_where_that_is_asked_for(tmp_path):
    time = late(1.6, 10)
    with pytest.raises(InputError, match=r"200 of 2000 time steps .* with --resample 500"):
        swung(tmp_path, time)
    trial = swung(tmp_path, time, resample=500)
    assert trial.sampling_rate == pytest.approx(500)
    np.testing.assert_allclose(trial.angle, 0.1 * np.cos(7 * trial.time), atol=1e-4)


def test_thinned_to_fewer_samples_nothing_folds_back(tmp_path):
    time = late(1.6, 10)
    fast = 0.05 * np.sin(2 * np.pi * 190 * time)
    path = written(tmp_path, text_of(time, np.sin(9 * time) + fast, 0.1 * np.cos(7 * time)))
    trial = read_trial(path, resample=100)
    inner = slice(20, -20)
    assert trial.sampling_rate == pytest.approx(100)
    assert np.abs(trial.torque - np.sin(9 * trial.time))[inner].max() < 0.02
    even = read_trial(written(tmp_path, text_of(TIME, TORQUE, ANGLE)), resample=1000)
    assert_same(even)


@pytest.mark.parametrize(
    ("time", "options", "sentence"),
    [
        (late(7, 900), {}, r"across no more than 5 of these: cut the recording there"),
        (late(7, 900), {"resample": 100}, "cut the recording there"),
        (late(1, 900), {"resample": 900}, "900 Hz is asked for, but the file has 500 samples a"),
        (late(1, 900), {"resample": -1}, "-1 Hz is asked for"),
        (late(1, 900), {"resample": math.nan}, "nan Hz is asked for"),
    ],
)
def test_what_cannot_be_resampled_is_refused(tmp_path, time, options, sentence):
    with pytest.raises(InputError, match=sentence):
        swung(tmp_path, time, **options)


def changed(row, text):
    """The file with one of its rows replaced, counted from 1 as an editor does."""
    lines = text_of(TIME, TORQUE, ANGLE).splitlines()
    lines[row - 1] = text
    return "\n".join(lines)


ALL = {"time": ("time_s", "s"), "torque": ("torque_Nm", "Nm"), "angle": ("angle_rad", "rad")}
BARE = text_of(TIME, ANGLE, ANGLE, TORQUE, header="time,position,velocity,torque")
NO_HEADER = text_of(TIME, TORQUE, ANGLE, header="")


@pytest.mark.parametrize(
    ("text", "options", "sentence"),
    [
        ("", {}, r"empty \(0 bytes\)"),
        ("\n\n# nothing\n", {}, "no data"),
        ("time_s,torque_Nm,angle_rad\n", {}, "header .* and no samples"),
        (b"\x00\x01\x02,\x03", {}, "not a text file"),
        (changed(7, "0.005,abc,0.1"), {}, "row 7, column 'torque_Nm': 'abc' is not a number"),
        (changed(7, "0.005,,0.1"), {}, "row 7, column 'torque_Nm': the cell is empty"),
        (changed(7, "0.005,1_0,0.1"), {}, "row 7, .*'1_0' is not a number"),
        (changed(7, "0.005,0.1"), {}, "row 7 has 2 values, where the header has 3"),
        (changed(7, "0.005,1,2,3"), {}, "row 7 has 4 values, where the header has 3"),
        (changed(1, "0.0,0.1"), {"columns": BY_INDEX}, "row 2 has 3 values, where the first row"),
        (changed(7, "0.003,1.0,0.1"), {}, "row 7: time must increase"),
        (changed(7, "0.005,1.0,NaN"), {}, "row 7, column 'angle_rad': the value is nan"),
        (changed(7, "0.005,-inf,0"), {}, "row 7, column 'torque_Nm': the value is -inf"),
        (changed(7, "0.0052,1.0,0.1"), {}, "row 7: the time step is 0.0012 s where 0.001 s"),
        (changed(7, "1e999,1.0,0.1"), {}, "row 7, column 'time_s': the value is inf"),
        (
            BARE,
            {},
            r"header \(time, position, velocity, torque\) does not tell .* --columns "
            "time=time:s angle=position:rad torque=torque:Nm, with the units",
        ),
        (BARE, {"rate": 1000.0}, "write --columns angle=position:rad torque=torque:Nm"),
        (
            text_of(TORQUE, ANGLE, header="torque_Nm,angle (deg)"),
            {},
            "is time, .*--rate HZ --columns 'angle=angle .deg.:deg' torque=torque_Nm:Nm",
        ),
        (text_of(TORQUE, ANGLE, header="V1,V2"), {"rate": 9.0}, "angle=COLUMN:rad torque=COLUMN"),
        (
            text_of(TIME, TORQUE, ANGLE, header="time_s,torque_Nm,angle_Nm"),
            {},
            "does not tell which column is angle",
        ),
        (
            text_of(TIME, TORQUE, ANGLE, ANGLE, header="time_s,torque_Nm,q_rad,pos_deg"),
            {},
            r"several columns may be angle \(q_rad, pos_deg\)",
        ),
        (NO_HEADER, {}, "no header: name the columns by index.*--columns angle=0:rad torque=1:Nm"),
        (NO_HEADER, {"columns": ALL}, "no header, so no column is named 'time_s'"),
        (
            text_of(TIME, TORQUE, ANGLE),
            {"columns": ALL | {"angle": ("knee", "rad")}},
            "no column is named 'knee': the columns are time_s, torque_Nm, angle_rad",
        ),
        (
            NO_HEADER,
            {"columns": BY_INDEX | {"angle": (3, "rad")}},
            "column 3 is out of range.*0 to",
        ),
        (NO_HEADER, {"columns": BY_INDEX | {"angle": (-1, "rad")}}, "column -1 is out of range"),
        (NO_HEADER, {"columns": BY_INDEX | {"angle": (1, "rad")}}, "named for two quantities"),
        (
            text_of(TIME, TORQUE, ANGLE, header="a,b,b"),
            {"columns": {"torque": ("b", "Nm"), "angle": ("a", "rad")}, "rate": 1.0},
            "2 columns are named 'b'",
        ),
        (NO_HEADER, {"columns": {"torque": (1, "Nm"), "angle": (2, "rad")}}, "no time column and"),
        (NO_HEADER, {"columns": BY_INDEX, "rate": 500.0}, "given as 500 Hz, but .* has 1000 Hz"),
        (NO_HEADER, {"columns": BY_INDEX, "rate": -1.0}, "rate is -1.0 Hz, but must be above 0"),
        (NO_HEADER, {"columns": BY_INDEX, "rate": math.nan}, "rate is nan Hz"),
        (
            NO_HEADER,
            {"columns": BY_INDEX, "variable": "z"},
            "variable .z. is named, but .csv files hold none",
        ),
        (NO_HEADER, {"columns": BY_INDEX, "driven": "force"}, "driven is 'force'"),
        (text_of(TIME[:1], TORQUE[:1], ANGLE[:1]), {}, "at least 3 samples, found 1"),
        (text_of(TIME, TORQUE, 0 * ANGLE), {}, "angle is constant"),
        (text_of(TIME, 0 * TORQUE, ANGLE), {}, "torque is constant"),
        ("angle_rad\n1\n2\n3\n", {"rate": 1.0}, "does not tell which column is torque"),
    ],
)
def test_bad_text_files_get_one_sentence(tmp_path, text, options, sentence):
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=sentence) as caught:
        read_trial(path, **options)
    message = str(caught.value)
    assert message.startswith("trial.csv: ")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"angle": (0, "Nm"), "torque": (1, "Nm")}, "'Nm' is a unit of torque"),
        ({"angle": (0, "rad")}, "no column is named for torque"),
        ({}, "no column is named for angle and torque"),
        ({"angle": "0:rad", "torque": (1, "Nm")}, "column of angle is given as '0:rad'"),
        ({"force": (0, "N")}, "'force' is not a quantity"),
    ],
)
def test_bad_columns_get_one_sentence(tmp_path, columns, sentence):
    with pytest.raises(InputError, match=sentence):
        read_trial(written(tmp_path, NO_HEADER), columns=columns)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("missing.csv", "missing.csv: there is no such file"),
        ("folder.csv", "folder.csv: this is a directory"),
        ("notes.docx", "suffix '.docx' are not read: give one of .csv, .tsv, .txt, .dat, .mat"),
        ("trial", "suffix '' are not read"),
        ("nul\0.csv", "cannot be opened"),
    ],
)
def test_paths_that_are_no_recording(tmp_path, name, sentence):
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "notes.docx").write_text("x")
    with pytest.raises(InputError, match=sentence):
        read_trial(tmp_path / name)


# A format of one's own


def read_pairs(path, options):
    """Pairs of angle [deg] and torque [Nm], as binary numbers."""
    options.refuse_variable(path.suffix)
    angle, torque = np.fromfile(path).reshape(-1, 2).T
    return Table((angle, torque), ("angle_deg", "torque_Nm"), range(1, angle.size + 1))


def test_a_reader_is_one_line(tmp_path, monkeypatch):
    path = written(tmp_path, np.stack([np.degrees(ANGLE), TORQUE], axis=1).tobytes(), "a.PAIRS")
    with pytest.raises(InputError, match=r"'.pairs' are not read"):
        read_trial(path, rate=1000.0)
    monkeypatch.setitem(READERS, ".pairs", read_pairs)
    assert_same(read_trial(path, rate=1000.0))
    assert_same(read_trial(path, rate=1000.0, restoring=True), torque=-TORQUE)
    with pytest.raises(InputError, match="variable 'z' is named"):
        read_trial(path, rate=1000.0, variable="z")


def test_a_folder_is_the_readable_files_in_it(tmp_path, monkeypatch):
    for name in ("b.csv", "a.mat", "c.PAIRS", "report.html"):
        written(tmp_path, b"x", name)
    assert [f.name for f in readable_files([tmp_path])] == ["a.mat", "b.csv"]
    monkeypatch.setitem(READERS, ".pairs", read_pairs)
    found = readable_files([tmp_path / "report.html", tmp_path])
    assert [f.name for f in found] == ["report.html", "a.mat", "b.csv", "c.PAIRS"]


# MATLAB files

MATRIX = np.stack([ANGLE, TORQUE], axis=1)
OF_MATRIX = {"angle": (0, "rad"), "torque": (1, "Nm")}
OF_VECTORS = {"time": ("t", "s"), "angle": ("q", "rad"), "torque": ("u", "Nm")}
VECTORS = {"t": TIME, "u": TORQUE, "q": ANGLE}


def save_v73(path, variables):
    """The layout of MATLAB v7.3: column-major matrices, structs as groups, text as char codes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            if isinstance(value, dict):
                for field, vector in value.items():
                    file[f"{name}/{field}"] = np.atleast_2d(vector)
            elif isinstance(value, str):
                file[name] = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
                file[name].attrs["MATLAB_class"] = np.bytes_(b"char")
            else:
                file[name] = np.atleast_2d(np.asarray(value).T)
        file["#refs#/a"] = np.eye(3)


@pytest.fixture(params=["v5", "v7.3"])
def save(request, tmp_path):
    def saved(variables):
        path = tmp_path / "trial.mat"
        if request.param == "v5":
            io.savemat(path, variables)
        else:
            save_v73(path, variables)
        return path

    return saved


HEADED = {"time": ("time", "s"), "angle": ("knee", "deg"), "torque": ("knee_moment", "Nm")}


def opensim(*lines, name="inverse dynamics"):
    head = [name, "version=1", f"nRows={TIME.size}", "nColumns=3", *lines, "endheader"]
    columns = (TIME, TORQUE, np.degrees(ANGLE))
    return (
        "\n".join(head) + "\n" + text_of(*columns, header="time\tknee_moment\tknee", separator="\t")
    )


@pytest.mark.parametrize("suffix", ["sto", "mot"])
def test_opensim_files(tmp_path, suffix):
    path = written(tmp_path, opensim("inDegrees=yes"), f"trial.{suffix}")
    trial = read_trial(path, columns=HEADED)
    assert_same(trial)
    assert any("deg" in note for note in trial.notes)


def test_opensim_files_that_contradict_their_header(tmp_path):
    path = written(tmp_path, opensim("inDegrees=no"), "trial.mot")
    with pytest.raises(InputError, match="says inDegrees=no, and the angle is said to be in deg"):
        read_trial(path, columns=HEADED)
    path = written(tmp_path, text_of(TIME, TORQUE, ANGLE), "trial.sto")
    with pytest.raises(InputError, match="no line 'endheader'"):
        read_trial(path)


def save_hdf5(path, variables, units=()):
    with h5py.File(path, "w") as file:
        for name, value in variables.items():
            file[name] = value
        for name, unit in dict(units).items():
            file[name].attrs["units"] = unit
    return path


def test_vectors_of_an_hdf5_group(tmp_path):
    group = {f"trials/first/{name}": vector for name, vector in VECTORS.items()}
    path = save_hdf5(tmp_path / "trial.h5", group)
    assert_same(read_trial(path, columns=OF_VECTORS))
    more = group | {f"trials/second/{name}": 2 * vector for name, vector in VECTORS.items()}
    path = save_hdf5(tmp_path / "trials.hdf5", more)
    assert_same(read_trial(path, columns=OF_VECTORS, variable="trials/first"))
    with pytest.raises(InputError, match=r"trials/first .struct of q, t, u., trials/second"):
        read_trial(path, columns=OF_VECTORS)


def test_units_of_an_hdf5_file(tmp_path):
    named = {"time": 1e3 * TIME, "torque": TORQUE, "angle": np.degrees(ANGLE)}
    units = {"time": "ms", "torque": b"Nm", "angle": "deg"}
    assert_same(read_trial(save_hdf5(tmp_path / "trial.h5", named, units)))
    with pytest.raises(InputError, match="does not tell"):
        read_trial(save_hdf5(tmp_path / "none.h5", named))


def test_a_matrix_or_a_table_of_an_hdf5_file(tmp_path):
    path = save_hdf5(tmp_path / "matrix.h5", {"z": MATRIX})
    assert_same(read_trial(path, columns=OF_MATRIX, rate=1000.0))
    fields = np.zeros(TIME.size, [(name, float) for name in VECTORS])
    for name, vector in VECTORS.items():
        fields[name] = vector
    path = save_hdf5(tmp_path / "table.h5", {"rec/table": fields})
    assert_same(read_trial(path, columns=OF_VECTORS))


@pytest.mark.parametrize("content", [b"not hdf5", b"\x89HDF\r\n\x1a\n" + bytes(200)])
def test_a_damaged_hdf5_file(tmp_path, content):
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        read_trial(written(tmp_path, content, "trial.h5"), columns=OF_MATRIX, rate=1000.0)


def test_the_only_matrix_is_taken(save):
    path = save({"z": MATRIX, "fs": 1000.0, "comment": "right ankle"})
    trial = read_trial(path, columns=OF_MATRIX, rate=1000.0)
    assert_same(trial)
    assert trial.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_one_of_several_matrices_is_named(save):
    path = save({"z": MATRIX, "y": MATRIX[:10]})
    assert_same(read_trial(path, variable="z", columns=OF_MATRIX, rate=1000.0))


def test_channels_in_rows_are_transposed(save):
    trial = read_trial(save({"z": MATRIX.T}), columns=OF_MATRIX, rate=1000.0)
    assert_same(trial)
    assert "transposed" in trial.notes[0]


@pytest.mark.parametrize("variable", [None, "rec"])
def test_vectors_of_a_struct(save, variable):
    path = save({"rec": VECTORS})
    assert_same(read_trial(path, variable=variable, columns=OF_VECTORS))


def test_separate_vectors(save):
    assert_same(read_trial(save(VECTORS | {"z": np.eye(3)}), columns=OF_VECTORS))
    named = {"time_s": TIME, "torque_Nm": TORQUE, "angle_rad": ANGLE}
    assert_same(read_trial(save(named)))


@pytest.mark.parametrize(
    ("variables", "options", "sentence"),
    [
        ({"z": MATRIX}, {}, "a matrix has no header: .*--columns angle=0:rad torque=1:Nm"),
        ({"z": MATRIX}, {"variable": "y"}, r"no numeric variable 'y' .* holds z \(40 x 2\)"),
        ({"z": MATRIX, "y": MATRIX}, {"columns": OF_MATRIX}, r"name a variable; .*z \(40 x 2\)"),
        ({"c": "text"}, {"columns": OF_MATRIX}, "no numeric matrix or struct"),
        ({"q": ANGLE}, {"columns": OF_MATRIX}, "name a variable; the file holds q"),
        ({"q": ANGLE}, {"columns": OF_MATRIX, "variable": "q"}, "one vector of 40 values"),
        ({"z": MATRIX}, {"columns": OF_VECTORS}, "no header, so no column is named 't'"),
        ({"r": VECTORS}, {}, r"header \(., ., .\) does not tell"),
        (
            {"r": VECTORS | {"q": ANGLE[:9]}},
            {"columns": OF_VECTORS},
            "lengths are time 40, angle 9, torque 40",
        ),
        (
            {"z": np.where(MATRIX[4, 1] == MATRIX, np.nan, MATRIX)},
            {"columns": OF_MATRIX, "rate": 1e3},
            "row 5, column 1: the value is nan",
        ),
        ({"z": MATRIX}, {"columns": OF_MATRIX}, "no time column and no sampling rate"),
    ],
)
def test_bad_matlab_files_get_one_sentence(save, variables, options, sentence):
    path = save(variables)
    with pytest.raises(InputError, match=sentence) as caught:
        read_trial(path, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [10, 200, 500, 3000])
def test_a_damaged_matlab_file(save, kept):
    path = save({"z": np.random.default_rng(0).standard_normal((400, 2))})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"cannot be read as a MATLAB file|no numeric matrix"):
        read_trial(path, columns=OF_MATRIX, rate=1000.0)


# Parsers in a process of their own


def aborts(path):
    os.abort()


def crashes(path):
    os.kill(os.getpid(), signal.SIGSEGV)


def raises(path):
    raise KeyError(path)


def fills_the_memory(path):
    return bytearray(1 << 40)


def never_ends(path):
    time.sleep(60)


@pytest.mark.parametrize(
    ("parser", "sentence"),
    [
        (aborts, r"as such a file \(its parser breaks down\)"),
        (crashes, "its parser breaks down"),
        (raises, r"as such a file \(KeyError\)"),
        (fills_the_memory, r"\(MemoryError\)"),
        (never_ends, "it was not done within 1 s"),
    ],
)
def test_a_parser_that_breaks_down_is_one_sentence(tmp_path, monkeypatch, parser, sentence):
    if parser is never_ends:
        monkeypatch.setattr(apart, "SECONDS", 1.0)
    path = written(tmp_path, "x")
    with pytest.raises(InputError, match=sentence) as caught:
        apart.apart(parser, path, "such a file")
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    assert apart.apart(Path.read_text, path, "text") == "x"  # the next file is read


def save_c3d(path, labels=("angle", "torque", "emg"), units=("deg", "Nm", "V")):
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    file["parameters"]["ANALOG"]["RATE"]["value"] = [1000]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = labels
    file["parameters"]["ANALOG"]["UNITS"]["value"] = units
    file["data"]["points"] = np.zeros((4, 0, TIME.size // 10))
    file["data"]["analogs"] = np.stack([np.degrees(ANGLE), TORQUE, 0 * TIME])[None]
    file.write(str(path))
    return path


def assert_nearly(trial):
    """C3D files have single precision."""
    np.testing.assert_allclose(trial.time, TIME, atol=1e-9)
    np.testing.assert_allclose(trial.torque, TORQUE, rtol=1e-6)
    np.testing.assert_allclose(trial.angle, ANGLE, rtol=1e-6)


def test_analog_channels_of_c3d(tmp_path):
    assert_nearly(read_trial(save_c3d(tmp_path / "trial.c3d")))
    volts = save_c3d(tmp_path / "volts.c3d", units=("V", "V", "V"))
    with pytest.raises(InputError, match="does not tell which column is torque and which is angle"):
        read_trial(volts)
    named = {"time": ("time (s)", "s"), "angle": ("angle (V)", "deg"), "torque": (2, "Nm")}
    assert_nearly(read_trial(volts, columns=named))


@pytest.mark.parametrize("seed", range(6))
def test_a_damaged_c3d(tmp_path, seed):
    path = save_c3d(tmp_path / "trial.c3d")
    rng, content = np.random.default_rng(seed), bytearray(path.read_bytes())
    if seed % 2:
        del content[rng.integers(len(content)) :]
    for place in rng.integers(0, len(content), 20):
        content[place] = rng.integers(256)
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        assert np.isfinite(read_trial(path).torque).all()


def test_groups_of_tdms(tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    path = tmp_path / "trial.tdms"
    clock = {"wf_increment": 1e-3}
    with TdmsWriter(str(path)) as file:
        file.write_segment(
            [
                ChannelObject("rig", "angle", np.degrees(ANGLE), clock | {"unit_string": "deg"}),
                ChannelObject("rig", "torque", TORQUE, clock | {"NI_UnitDescription": "Nm"}),
                ChannelObject("log", "temperature", TIME[:3], {}),
            ]
        )
    with pytest.raises(InputError, match=r"name a variable; the file holds log .* rig"):
        read_trial(path)
    assert_same(read_trial(path, variable="rig"))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match=r"cannot be read as TDMS|no numeric"):
        read_trial(path, variable="rig")


def save_bids(folder, units=("deg", "Nm"), rate='{"SamplingFrequency": 1000}'):
    stem = "sub-01_task-servo_tracksys-motor"
    rows = np.stack([np.degrees(ANGLE), TORQUE], axis=1)
    np.savetxt(folder / f"{stem}_motion.tsv", rows, delimiter="\t")
    names = [f"{n}\tANY\t{u}" for n, u in zip(("knee_angle", "knee_torque"), units, strict=True)]
    written(folder, "name\ttype\tunits\n" + "\n".join(names), f"{stem}_channels.tsv")
    if rate:
        written(folder, rate, f"{stem}_motion.json")
    return folder / f"{stem}_motion.tsv"


def test_bids_motion_with_its_sidecars(tmp_path):
    path = save_bids(tmp_path)
    trial = read_trial(path)
    assert_same(trial)
    assert "1000 Hz by sub-01_task-servo_tracksys-motor_motion.json" in trial.notes
    assert readable_files([tmp_path]) == [path]


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ({"rate": "{}"}, "tells no SamplingFrequency above 0"),
        ({"rate": '{"SamplingFrequency": "fast"}'}, "tells no SamplingFrequency above 0"),
        ({"rate": ""}, "does not tell which column is time"),
        ({"units": ("deg", "n/a")}, "does not tell which column is torque"),
        ({}, "lists 1 channels, where the file has 2 columns"),
    ],
)
def test_sidecars_that_do_not_tell(tmp_path, how, sentence):
    path = save_bids(tmp_path, **how)
    if not how:
        written(tmp_path, "name\tunits\nangle\tdeg\n", path.name.replace("motion", "channels"))
    with pytest.raises(InputError, match=sentence):
        read_trial(path)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_tables_in_matlab_files(tmp_path, version):
    import matio
    import pandas as pd

    frame = pd.DataFrame({"time_s": TIME, "torque_Nm": TORQUE, "angle_deg": np.degrees(ANGLE)})
    path, both = tmp_path / "table.mat", tmp_path / "both.mat"
    matio.save_to_mat(str(path), {"trial": frame}, version=version)
    assert_same(read_trial(path))
    # What is there without any object is read whether or not these can be.
    matio.save_to_mat(str(both), {"trial": frame, "z": MATRIX}, version=version)
    assert_same(read_trial(both, columns=OF_MATRIX, rate=1000.0))
    assert_same(read_trial(both, variable="trial"))


@pytest.mark.parametrize(
    ("library", "suffix"), [("matio", "mat"), ("ezc3d", "c3d"), ("nptdms", "tdms")]
)
def test_a_library_that_is_not_there(tmp_path, monkeypatch, library, suffix):
    path = tmp_path / f"trial.{suffix}"
    path.write_bytes(b"x")
    for module in (extras, matlab):
        monkeypatch.setattr(module, "is_installed", lambda name: name != library)
    if library == "matio":
        monkeypatch.setattr(matlab, "apart", lambda *_: ({}, {"": {}}))
    with pytest.raises(InputError, match=r"pip install 'identifiability\[readers\]'"):
        read_trial(path)


# Sign


def imposed_angle(sign):
    time = np.arange(2000) * 1e-3
    angle = 0.05 * np.sin(12 * time) + 0.02 * np.sin(60 * time)
    rate = np.gradient(angle, 1e-3)
    torque = 50.0 * angle + 1.0 * rate + 0.1 * np.gradient(rate, 1e-3)
    return text_of(time, sign * torque, angle)


@pytest.mark.parametrize(
    ("sign", "restoring", "driven", "remedy"),
    [
        (-1, False, "angle", "add --restoring"),
        (1, True, "angle", "leave --restoring out"),
        (1, False, "angle", None),
        (-1, True, "angle", None),
        (-1, False, "torque", None),
    ],
)
def test_a_suspicious_sign_is_told(tmp_path, sign, restoring, driven, remedy):
    path = written(tmp_path, imposed_angle(sign))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_trial(path, restoring=restoring, driven=driven)
    if remedy is None:
        assert caught == []
    else:
        assert len(caught) == 1
        assert "looks reversed" in str(caught[0].message)
        assert remedy in str(caught[0].message)


# Anything at all


def read_or_refuse(path, content, **options):
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", UserWarning)  # degrees, sign
        try:
            result = read_trial(path, **options)
        except InputError as error:
            result = str(error)
    assert isinstance(result, Trial) or "\n" not in result


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("scratch") / "any.csv"


@settings(deadline=None, max_examples=150, derandomize=True)
@given(content=st.binary(max_size=200))
def test_random_bytes_give_a_trial_or_a_sentence(scratch, content):
    read_or_refuse(scratch, content, columns=OF_MATRIX, rate=100.0)


CELL = st.one_of(
    st.floats(width=64).map(repr),
    st.floats(-10, 10).map(lambda value: f"{value:.3f}"),
    st.sampled_from(["", "x", "1,5", '"2"', "nan", "time_s", "1e308", "-1e-320", " 3 "]),
)


@settings(
    deadline=None,
    max_examples=300,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    rows=st.lists(st.lists(CELL, min_size=2, max_size=4), min_size=3, max_size=8)
    | st.lists(st.tuples(st.floats(width=64).map(repr), CELL, CELL), min_size=3, max_size=60),
    separator=st.sampled_from([",", ";", "\t", " "]),
    timed=st.booleans(),
    driven=st.sampled_from(["torque", "angle"]),
)
def test_random_tables_give_a_trial_or_a_sentence(scratch, rows, separator, timed, driven):
    content = "\n".join(separator.join(row) for row in rows).encode()
    options = {"columns": BY_INDEX} if timed else {"columns": OF_MATRIX, "rate": 100.0}
    read_or_refuse(scratch, content, driven=driven, **options)


@settings(deadline=None, max_examples=100, derandomize=True)
@given(
    values=st.lists(st.tuples(st.floats(), st.floats()), min_size=60, max_size=80),
    rate=st.floats(1e-300, 1e300),
)
def test_random_numbers_give_a_trial_or_a_sentence(scratch, values, rate):
    content = "\n".join(f"{a!r},{b!r}" for a, b in values).encode()
    read_or_refuse(scratch, content, columns=OF_MATRIX, rate=rate, driven="angle")


# Real recordings


@needs_real
def test_the_ankle():
    options = {"variable": "z", "columns": OF_MATRIX, "rate": 1000.0, "driven": "angle"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trial = read_trial(REAL / "reklab_ankle_z.mat", restoring=True, **options)
    assert trial.n_samples == 60000
    assert trial.sha256.startswith("ca9d219c4431")
    found = onsets(trial)
    assert 220 <= found.size <= 240
    assert np.median(np.diff(found)) == pytest.approx(250, abs=5)
    moved = np.abs(trial.angle[np.minimum(found + 150, 59999)] - trial.angle[found])
    assert moved.min() > 0.004
    with pytest.warns(UserWarning, match="add --restoring"):
        read_trial(REAL / "reklab_ankle_z.mat", **options)


@needs_real
def test_the_pendulum():
    columns = parse_columns(["time=time:s", "angle=position:rad", "torque=torque:Nm"])
    trial = read_trial(REAL / "dfki_pendulum_ddp.csv", columns=columns)
    assert trial.sampling_rate == pytest.approx(500.0, rel=1e-3)
    assert "time steps varied by 1 %" in trial.notes[0]
    with pytest.raises(InputError, match="angle=position:rad torque=torque:Nm"):
        read_trial(REAL / "dfki_pendulum_ddp.csv")


@needs_real
def test_the_silverbox():
    columns = parse_columns(["torque=V1:Nm", "angle=V2:rad"])
    trial = read_trial(REAL / "silverbox_SNLS80mV.csv", columns=columns, rate=610.35)
    assert trial.n_samples == 131072
    assert trial.torque[0] == 0.0057756
    assert trial.angle[1] == 0.012971


@pytest.mark.skipif(not (DATA / "practice").is_dir(), reason="needs ../shared/data/practice")
def test_a_practice_trial():
    trial = read_trial(DATA / "practice" / "p01" / "trial_01.csv")
    assert trial.sampling_rate == pytest.approx(1000.0)
    assert quiet_lead(trial) == 50
    assert trial.torque.max() == 60.0
