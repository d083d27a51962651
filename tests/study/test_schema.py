"""Study files: units become SI, every mistake is one clear paragraph, and nothing is half-written."""

import re
import tomllib

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.study import packaged
from structid.study.build_study import build
from structid.study.run import load, run_study
from structid.study.schema.problems import StudyErrors
from structid.study.study_reader import parse_study
from studies import PACKAGED, SMALL


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_a_parameter_may_have_the_name_of_a_prior_s_key():
    """A beta distribution has a and b; a parameter called a has all keys of a prior."""
    with pytest.raises(
        StudyErrors, match=r"parameters\.a\.law': an unknown key\. Allowed here: a, b, distribution, high"
    ):
        parse_study(
            tomllib.loads(SMALL.replace("[parameters.stiffness]", "[parameters.a]\nlaw = 1\n[parameters.stiffness]"))
        )


@pytest.mark.parametrize("name", packaged.STUDIES)
def test_every_packaged_study_builds(name, tmp_path):
    if name == "measured":  # which reads a user's own files
        record = si.GroundMotion.synthetic(seed=3, duration=8.0)
        for file, values in (("MY_RECORD.AT2", record.values / 9.80665), ("MY_TOP.csv", 10.0 * record.values)):
            head = f"PEER\nMADE\nACCELERATION TIME SERIES IN UNITS OF G\nNPTS= {len(record)}, DT= {record.dt} SEC\n"
            rows = "\n".join(
                f"{t:.3f}, {v:.6f}" if "csv" in file else f"{v:.7E}" for t, v in zip(record.time, values, strict=True)
            )
            (tmp_path / file).write_text(("" if "csv" in file else head) + rows + "\n")
    content = tomllib.loads(packaged.template(name))
    if name in packaged.SOLVERS:
        (tmp_path / packaged.SOLVERS[name]).write_text(packaged.template(packaged.SOLVERS[name]))
    built = build(parse_study(content), tmp_path)
    assert np.isfinite(built.posterior.log_density(built.posterior.space.sample(2, seed=1).values)).all()


def test_units_become_si(small):
    built = load(small)
    assert built.posterior.model.mass == 12_000.0
    assert built.posterior.model.damping_ratio == 0.03
    assert built.record.pga == pytest.approx(1.8)
    assert built.truths[0].stiffness == 7.6e6
    assert built.posterior.space.marginals["stiffness"].support == (4.27e6, 11.85e6)


CHANGES = {
    "an unknown key, with the nearest known one": (
        'lowpass = "20 Hz"',
        'lowpas = "20 Hz"',
        ["record.lowpas", "Did you mean 'lowpass'"],
    ),
    "a unit of the wrong dimension": ('pga = "1.8 m/s^2"', 'pga = "1.8 kN"', ["record.pga", "1.8 kN", "m/s^2"]),
    "a mass with its thousands apart": (
        'mass = "12 t"',
        'mass = "12 000 kg"',
        ["model.mass", "the number could end after '12'"],
    ),
    "a pure number in quotes": ('damping_ratio = "3 %"', 'damping_ratio = "3"', ["model.damping_ratio", "'3 %'"]),
    "a damping of 300 %": ('damping_ratio = "3 %"', "damping_ratio = 3", ["'model'", "damping_ratio", "0 to 1"]),
    "a decimal comma": ('damping_ratio = "3 %"', "damping_ratio = 0,03", ["not valid TOML", "use a decimal point"]),
    "too many walkers for any machine": (
        "walkers = 12",
        "walkers = 1000000000",
        ["'sampler'", "GB of this machine"],
    ),
    "a number of steps with decimals": ("walkers = 12", "walkers = 2.5", ["sampler.walkers", "a whole number"]),
    "a text instead of a list": (
        'methods = ["pattern_search',
        'methods = "a"\nx = ["',
        ["deterministic.methods", "a list in brackets"],
    ),
    "a prior upside down": ("low = 55\nhigh = 65", "low = 65\nhigh = 55", ["parameters.beta", "low < high"]),
    "a prior truncated to nothing": ("sd = 0.742", "sd = 0.1\n", None),
    "a parameter the model lacks": ("[parameters.beta]", "[parameters.betta]", ["betta", "Did you mean 'beta'"]),
    "no such record": ("synthetic = { seed = 8 }", 'file = "nowhere.AT2"', ["nowhere.AT2", "no such file"]),
    "two sources": ("synthetic = { seed = 8 }", 'synthetic = { seed = 8 }\nfile = "a.AT2"', ["record", "exactly one"]),
    "an unknown channel": ('channels = ["velocity"]', 'channels = ["speed"]', ["speed", "velocity"]),
    "an unknown model": ('type = "bouc_wen"\nmass', 'type = "bouc_when"\nmass', ["bouc_when"]),
    "a missing model": ('type = "bouc_wen"\nmass', "mass", ["model", "missing"]),
    "odd walkers": ("walkers = 12", "walkers = 13", ["walkers", "even"]),
    "no TOML": ("[record]", "[record", ["TOML", "line"]),
    "both a value and a prior": (
        'damping_ratio = "3 %"',
        'damping_ratio = "3 %"\nbeta = 60',
        ["parameters.beta", "[model]"],
    ),
    "a wrong unit of a prior": ('unit = "1/m"', 'unit = "kg"', ["parameters.beta", "kg"]),
    "a wrong unit of a nuisance": (
        "[observation.virtual]",
        '[observation.time_shift]\ndistribution = "normal"\nunit = "kg"\nmean = 0\nsd = 1\n[observation.virtual]',
        ["observation.time_shift", "kg"],
    ),
    "a prediction of nothing": (
        "starts = 2",
        'starts = 2\n[prediction]\nchannels = ["acceleration"]',
        ["prediction.channels", "absolute_acceleration"],
    ),
    "too few walkers": ("walkers = 12", "walkers = 8", ["sampler.walkers", "10 or more"]),
    "a constraint with a typo": ("starts = 2", 'starts = 2\nconstraints = ["gama_ratio <= beta"]', ["gama_ratio"]),
    "bounds of nothing": (
        "starts = 2",
        "starts = 2\nbounds = { betta = [1, 2] }",
        ["deterministic.bounds.betta", "Did you mean 'beta'"],
    ),
    "no starts": ("starts = 2", "starts = 0", ["deterministic.starts"]),
    "a negative seed": ("seed = 1\n", "seed = -1\n", ["seed", "-1"]),
    "a derived typo": (
        "[observation]\n",
        '[derived]\ndelta_nnu = "2 * beta"\n[observation]\n',
        ["derived.delta_nnu", "delta_nu"],
    ),
    "a name for nothing": (
        "[parameters.beta]",
        '[parameters.junk]\ndistribution = "uniform"\nlow = 0\nhigh = 1\n[parameters.beta]',
        ["parameters.junk"],
    ),
    "a shape with a length unit and n = 2": (
        'damping_ratio = "3 %"\n',
        'damping_ratio = "3 %"\nexponent = 2\nbeta = "63 1/m"\n',
        ["beta", "plain number"],
    ),
    "an unknown distribution": (
        'distribution = "normal"',
        'distribution = "norml"',
        ["parameters.stiffness.distribution", "norml"],
    ),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_wrong_study_says_what_and_where(case, tmp_path):
    old, new, words = CHANGES[case]
    assert old in SMALL
    text = SMALL.replace(old, new, 1)
    if words is None:
        text, words = (
            text.replace("low = 4.27\nhigh = 11.85", "low = 9.5\nhigh = 11.85"),
            ["parameters.stiffness", "contains", "0.1"],
        )
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(si.InputError) as error:
        run_study(path, tmp_path / "out")
    message = str(error.value)
    assert all(word in message for word in words), message
    assert not (tmp_path / "out").exists()


def test_settling_fits_a_short_run(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text(SMALL.replace("settling_steps = 0\n", ""))
    assert load(path).sampler.settling_steps == 24


def test_everything_wrong_is_said_at_once(tmp_path):
    with pytest.raises(StudyErrors) as error:
        parse_study(
            tomllib.loads(
                SMALL.replace("lowpass =", "lowpas =").replace("walkers =", "walker =").replace('"12 t"', '"12 s"')
            )
        )
    assert len(error.value.problems) == 5  # two keys of two records, one of the sampler, two masses


def test_a_measured_file_of_another_length_or_step(tmp_path):
    record = load_small(tmp_path)
    time = record.time
    text = re.sub(r"\[observation.virtual\].*?\[discrepancy\]", "[discrepancy]", SMALL, flags=re.S)
    text = text.replace('channels = ["velocity"]', 'channels = ["velocity"]\nfile = "v.csv"\nunit = "mm/s"')
    (tmp_path / "m.toml").write_text(text)
    np.savetxt(tmp_path / "v.csv", np.column_stack([time, np.sin(time)]), delimiter=",")
    assert np.allclose(load(tmp_path / "m.toml").posterior.observations[0].values[:, 0], np.sin(time) * 1e-3)
    np.savetxt(tmp_path / "v.csv", np.column_stack([time[:-1], np.sin(time[:-1])]), delimiter=",")
    with pytest.raises(si.InputError, match=r"lasts 6 s, the record 6.01 s.*time_shift"):
        load(tmp_path / "m.toml")
    np.savetxt(tmp_path / "v.csv", np.column_stack([2 * time, np.sin(time)]), delimiter=",")
    with pytest.raises(si.InputError, match=r"lasts 12.02 s, the record 6.01 s.*time_shift"):
        load(tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text(text.replace('unit = "mm/s"', 'unit = "mm/s"\ntime_shift = "0 s"'))
    (observation,) = load(tmp_path / "m.toml").posterior.observations
    assert observation.dt == pytest.approx(0.02) and len(observation.values) == 301 and observation.left_out == (0, 300)


def load_small(tmp_path):
    (tmp_path / "s.toml").write_text(SMALL)
    return load(tmp_path / "s.toml").record


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('kind = "ar1"\nper_channel = true', "discrepancy.per_channel.*ar1 does not have"),
        ('kind = "damped_cosine"\ndamping = 1.2', "discrepancy.*below 1"),
        ('kind = "matern32"\ncorrelation_time = "3 m"', "discrepancy.correlation_time"),
        ('kind = "ar2"', "discrepancy.kind.*ar1"),
        ('kind = "drifting"\nevery = "5 m"', "discrepancy.every.*unit 'm'"),
        ('kind = "drifting"\nevery = -5', "every.*time between knots"),
        ('kind = "drifting"\nerrors = "white"', "discrepancy.errors.*damped_cosine"),
        ('kind = "iid"\nevery = "5 s"', "discrepancy.every.*iid does not have"),
    ],
)
def test_mistakes_in_the_law_of_the_errors(table, words, tmp_path):
    text = re.sub(r"\[discrepancy\]\nkind[^\n]*", "[discrepancy]\n" + table, SMALL)
    (tmp_path / "law.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        load(tmp_path / "law.toml")


def test_parameters_of_a_surrogate_do_not_drift(tmp_path):
    (tmp_path / "law.toml").write_text(
        PACKAGED.replace('[discrepancy]\nkind = "iid"', '[discrepancy]\nkind = "drifting"')
    )
    with pytest.raises(InputError, match=r"discrepancy.kind.*'drifting' with a \[surrogate\].*no \[surrogate\]"):
        load(tmp_path / "law.toml")


def test_a_correlated_law_by_one_word(tmp_path):
    text = re.sub(r"\[discrepancy\]\nkind[^\n]*", '[discrepancy]\nkind = "damped_cosine"\ndamping = 0.1', SMALL)
    (tmp_path / "law.toml").write_text(re.sub(r"walkers = \d+", "walkers = 20", text))
    posterior = load(tmp_path / "law.toml").sampled
    assert posterior.names[-3:] == ("sigma2", "sigma2_white", "frequency")
    assert np.isfinite(posterior.log_density(posterior.space.sample(4, seed=1).values)).any()


def test_what_is_listed_is_counted_from_one(tmp_path):
    """The second [[observation]] is observation.2, by pydantic and by us, and so is what is listed in it."""
    one = '[[observation]]\nchannels = ["velocity"]\nfile = "v.csv"\nunit = "m/s"\n'
    text = re.sub(r"\[observation\].*?\[discrepancy\]", one + "SECOND[discrepancy]", SMALL, flags=re.S)
    assert "SECOND" in text
    np.savetxt(tmp_path / "v.csv", np.column_stack([np.arange(4001) * 0.01, np.sin(np.arange(4001) * 0.01)]))
    for second, said in (
        (one.replace("unit", "units"), "key 'observation.2.units'"),
        (one.replace('"v.csv"', '"w.csv"'), "w.csv: there is no such file"),
        (one.replace('"m/s"', '"kN"'), "key 'observation.2.unit'"),
        (one.replace('["velocity"]', '["velocity", 3]'), "key 'observation.2.channels.2'"),
    ):
        (tmp_path / "study.toml").write_text(text.replace("SECOND", second))
        with pytest.raises(InputError) as found:
            load(tmp_path / "study.toml")
        assert said in str(found.value), (said, str(found.value))
