from .benchmark.cases import CaseSpec, HiddenCase, hidden_cases
from .benchmark.protocol import Recorder
from .errors import InputError
from .inference.archive import to_datatree, write_netcdf
from .inference.consistency import Consistency, Disagreement, Reading, Structural, consistency
from .inference.curvature import Curvature, curvature, largest_change
from .inference.fitting import Fit, fit, fit_simplex
from .inference.likelihood.coloured import Colour
from .inference.likelihood.estimate import NoiseEstimate
from .inference.likelihood.processes import Process, ProcessSum, Whitening
from .inference.noisy import NoisyFit
from .inference.problem import Observation, Prior, Problem, observe
from .inference.profiles import Profile, profile
from .inference.quadrature import Moments, quadrature
from .inference.recordings import (
    Goodness,
    HeldOut,
    RecordingFit,
    WindowFit,
    fit_recordings,
    fit_with_noise,
)
from .inference.sampling import Posterior, Sampler, sample
from .inference.widths import Width, Widths, widths
from .investigation.across.agreement import Across, FittedRecord, SharedParameter, across
from .investigation.across.weighed import SetAcross, weigh_across
from .investigation.findings import Findings
from .investigation.fits.candidate import Candidate, Residual
from .investigation.fits.kept import OnDisk
from .investigation.investigate import investigate
from .investigation.ladder.found import Found, Missing, Tried
from .investigation.models import FittedModel, fitted_models
from .investigation.next_experiment import Design, Limits, NextExperiment
from .investigation.posterior.claim import Claim
from .investigation.posterior.discrepancy import Discrepant
from .investigation.posterior.probabilities import Probabilities, SetProbability, WeighedSet
from .investigation.record import investigation_record
from .investigation.rivals import Rivals
from .investigation.rules import Rules
from .investigation.session import Investigation
from .investigation.smallest_seen.detectable import Detectable
from .investigation.split import Split
from .investigation.unexplained.account import Unexplained
from .investigation.unexplained.explanation import Family
from .investigation.unexplained.readouts import DelayReadout, MemoryKernel, MissingTorque, StaticMap
from .investigation.verdict.judge import Verdict
from .investigation.verdict.reasons import Reason
from .investigation.where.compare import Change, Comparison, Constancy, Estimate, TrialRow
from .investigation.where.locate import Location
from .investigation.where.view import Panel, View
from .investigation.wording.describe import describe
from .joint.effects import (
    EFFECTS,
    ActivationLag,
    Backlash,
    CoulombFriction,
    CubicStiffness,
    DampingByAngle,
    DampingByDirection,
    Effect,
    EndStop,
    Gravity,
    HillForceVelocity,
    MaxwellBranch,
    Motion,
    NonlinearTendon,
    QuadraticStiffness,
    SecondMass,
    SensorDelay,
    SensorDrift,
    SensorLowpass,
    SeriesTendon,
    ShortRangeStiffness,
    SoftCoupling,
    StretchReflex,
)
from .joint.model import KBI, Model, Reaction
from .joint.parameters import Parameter
from .joint.response import simulate
from .joint.scheme import Scheme
from .measurement.cutting import cut_at_onsets
from .measurement.example import example_trials
from .measurement.noise import Noise, matched_noise
from .measurement.perturbations import (
    PERTURBATIONS,
    DoublePulse,
    Drive,
    Impulse,
    Perturbation,
    Pulse,
    SampledTorque,
    Sinusoid,
    Step,
    imposed_motion,
    multisine,
    prbs,
)
from .measurement.prepared import Lead, Prepared, Treatment
from .measurement.readers.trial_file import read_trial
from .measurement.readers.two_files import ChannelFile, read_two_files
from .measurement.trials import Trial, onsets
from .plots.across import across_figure
from .plots.corner import corner_figure
from .plots.effects import look_alikes_figure
from .plots.investigation import alone_figure, ladder_figure, widths_figure
from .plots.investigation_unexplained import unexplained_figure
from .plots.investigation_where import comparison_figure, responses_figure, where_figure
from .plots.recording import cuts_figure, overlay_figure, windows_figure
from .plots.rivals import rivals_figure
from .report.investigation import write_report
from .study.approximations import high_frequency, low_frequency
from .study.paper import Optimum, paper_optimum
from .study.setting import MSM, Setting, error_problem, measured_problem
from .workbench.attempt import Attempt, Ranked, Ranking
from .workbench.difference import Difference
from .workbench.session import Session

__version__: str

__all__ = [  # noqa: RUF022 -- in the order of use
    "InputError",
    "Trial",
    "Prepared",
    "Treatment",
    "Lead",
    "read_trial",
    "read_two_files",
    "ChannelFile",
    "example_trials",
    "hidden_cases",
    "HiddenCase",
    "CaseSpec",
    "Recorder",
    "onsets",
    "cut_at_onsets",
    "Perturbation",
    "PERTURBATIONS",
    "Impulse",
    "Pulse",
    "DoublePulse",
    "Step",
    "Sinusoid",
    "SampledTorque",
    "multisine",
    "prbs",
    "imposed_motion",
    "Drive",
    "Noise",
    "matched_noise",
    "Parameter",
    "Effect",
    "Motion",
    "EFFECTS",
    "SeriesTendon",
    "NonlinearTendon",
    "MaxwellBranch",
    "ActivationLag",
    "StretchReflex",
    "HillForceVelocity",
    "ShortRangeStiffness",
    "QuadraticStiffness",
    "CubicStiffness",
    "CoulombFriction",
    "Gravity",
    "EndStop",
    "DampingByAngle",
    "DampingByDirection",
    "SecondMass",
    "SoftCoupling",
    "Backlash",
    "Scheme",
    "SensorDelay",
    "SensorLowpass",
    "SensorDrift",
    "Model",
    "Reaction",
    "KBI",
    "simulate",
    "observe",
    "Observation",
    "Prior",
    "Problem",
    "fit",
    "fit_simplex",
    "Fit",
    "curvature",
    "Curvature",
    "largest_change",
    "profile",
    "Profile",
    "sample",
    "Posterior",
    "Sampler",
    "quadrature",
    "Moments",
    "widths",
    "Widths",
    "Width",
    "fit_recordings",
    "RecordingFit",
    "WindowFit",
    "consistency",
    "Consistency",
    "Disagreement",
    "Reading",
    "Structural",
    "HeldOut",
    "Goodness",
    "investigate",
    "Session",
    "across",
    "Across",
    "FittedRecord",
    "SharedParameter",
    "weigh_across",
    "SetAcross",
    "Attempt",
    "Ranked",
    "Ranking",
    "Difference",
    "Rivals",
    "Investigation",
    "Findings",
    "Split",
    "Comparison",
    "TrialRow",
    "Estimate",
    "Constancy",
    "Change",
    "Location",
    "View",
    "Panel",
    "Rules",
    "OnDisk",
    "Residual",
    "Candidate",
    "WeighedSet",
    "Tried",
    "Missing",
    "fitted_models",
    "FittedModel",
    "Found",
    "Detectable",
    "Unexplained",
    "StaticMap",
    "MissingTorque",
    "MemoryKernel",
    "DelayReadout",
    "Family",
    "Probabilities",
    "SetProbability",
    "Discrepant",
    "Claim",
    "Verdict",
    "Reason",
    "describe",
    "Limits",
    "NextExperiment",
    "Design",
    "investigation_record",
    "write_report",
    "to_datatree",
    "fit_with_noise",
    "NoisyFit",
    "NoiseEstimate",
    "Process",
    "ProcessSum",
    "Whitening",
    "Colour",
    "write_netcdf",
    "MSM",
    "Setting",
    "error_problem",
    "measured_problem",
    "low_frequency",
    "high_frequency",
    "Optimum",
    "paper_optimum",
    "corner_figure",
    "ladder_figure",
    "alone_figure",
    "widths_figure",
    "unexplained_figure",
    "comparison_figure",
    "where_figure",
    "responses_figure",
    "rivals_figure",
    "look_alikes_figure",
    "across_figure",
    "overlay_figure",
    "windows_figure",
    "cuts_figure",
]
