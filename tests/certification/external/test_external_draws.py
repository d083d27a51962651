"""Draws of other programs, in whichever form they come: taken by name where there are names, or refused by a sentence."""

import numpy as np
import pandas
import pytest
import xarray

from structid.certification.external.external_draws import draws_of
from structid.core.errors import InputError

NAMES = ("stiffness", "beta")
UNITS = {"stiffness": "kN/mm", "beta": "1/m"}
RNG = np.random.default_rng(1)
CHAINS = np.stack([RNG.normal(7.4e6, 0.7e6, (2, 100)), RNG.normal(60.0, 3.0, (2, 100))], axis=-1)
FLAT = CHAINS.reshape(-1, 2)


def dataset(**attributes):
    return xarray.Dataset(
        {
            "beta": (("chain", "draw"), CHAINS[..., 1]),
            "stiffness": (("chain", "draw"), CHAINS[..., 0], attributes),
            "label": (("chain", "draw"), np.full((2, 100), "warm")),
            "date": ((), "2026-01-01"),
        },
        coords={"chain": [0, 1], "draw": np.arange(100)},
    )


FRAME = pandas.DataFrame({"note": "x", "beta": FLAT[:, 1], "lp__": 0.0, "stiffness": FLAT[:, 0]})
STRUCTURED = np.rec.fromarrays([FLAT[:, 1], FLAT[:, 0]], names=["beta", "stiffness"])


@pytest.mark.parametrize(
    "draws",
    [
        FRAME,
        FRAME.assign(beta=FRAME.beta.astype("Float64")),
        STRUCTURED,
        np.asarray(STRUCTURED),
        {"beta": FLAT[:, 1], "stiffness": list(FLAT[:, 0]), "note": ["x"] * 200},
        dataset().stack(sample=("chain", "draw")).isel(sample=slice(0, 199)),
        FLAT,
    ],
    ids=["DataFrame", "nullable", "recarray", "structured", "mapping", "az.extract, thinned", "array"],
)
def test_columns_are_taken_by_name(draws):
    found = draws_of(draws, NAMES, UNITS)
    assert found.shape[0] == 1
    np.testing.assert_array_equal(found[0], FLAT[: found.shape[1]])


@pytest.mark.parametrize(
    "draws",
    [
        dataset(),
        dataset(units="N m-1"),
        dataset().stack(sample=("chain", "draw")),
        dataset()[["beta", "stiffness"]].to_dataframe(),
        dataset()[["beta", "stiffness"]].to_dataframe().reset_index().sample(frac=1.0, random_state=2),
        CHAINS,
    ],
    ids=["Dataset", "CF units in SI", "az.extract", "index of a DataFrame", "columns of a DataFrame", "array"],
)
def test_chains_are_kept_apart(draws):
    found = draws_of(draws, NAMES, UNITS)
    order = np.argsort(found[:, 0, 0])
    np.testing.assert_array_equal(found[order], CHAINS[np.argsort(CHAINS[:, 0, 0])])


@pytest.mark.parametrize("attribute", ["unit", "units"])
def test_the_unit_of_a_variable_is_used_under_either_name(attribute):
    scaled = dataset(**{attribute: "kN mm-1"})
    scaled["stiffness"] = scaled["stiffness"] / 1e6
    scaled["stiffness"].attrs[attribute] = "kN mm-1"
    np.testing.assert_allclose(draws_of(scaled, NAMES, UNITS), CHAINS, rtol=1e-15)


def test_a_unit_that_cannot_be_is_refused():
    with pytest.raises(
        InputError, match=r"stiffness: the unit 'mm'. Expected: a unit of the same dimension as 'kN/mm'"
    ):
        draws_of(dataset(units="mm"), NAMES, UNITS)
    with pytest.raises(InputError, match=r"unit = 'N/m' and units = 'kN/m'\. Expected: one unit"):
        draws_of(dataset(unit="N/m", units="kN/m"), NAMES, UNITS)


TABLE = "\n".join(f"{k!r},{b!r}" for k, b in FLAT.tolist())


@pytest.mark.parametrize(
    "text",
    [
        f"stiffness,beta\n{TABLE}\n",
        "\ufeffstiffness,beta\n" + TABLE,
        "# CmdStan\n#   adapt\nstiffness, beta\n# adaptation\n" + TABLE,
        ",stiffness,beta\n" + "\n".join(f"{i},{line}" for i, line in enumerate(TABLE.split("\n"))),
        '"stiffness";"beta"\n' + TABLE.replace(",", ";"),
        "stiffness;beta\n" + TABLE.replace(",", ";").replace(".", ","),
        "stiffness\tbeta\n" + TABLE.replace(",", "\t"),
        "stiffness  beta\n" + TABLE.replace(",", "   "),
        "note,beta,stiffness\n" + "\n".join(f"x,{b!r},{k!r}" for k, b in FLAT.tolist()),
    ],
    ids=[
        *("commas", "byte order mark", "comments", "index column", "semicolons", "decimal commas", "tabs", "spaces"),
        "text beside",
    ],
)
def test_tables_of_text(text, tmp_path):
    file = tmp_path / "draws.csv"
    file.write_text(text, encoding="utf-8")
    np.testing.assert_allclose(draws_of(file, NAMES, UNITS)[0], FLAT, rtol=1e-15)


@pytest.mark.parametrize(
    ("draws", "words"),
    [
        (FRAME.rename(columns={"beta": "gamma"}), "Add draws of beta"),
        (FRAME.assign(beta="sixty"), "certify\\(draws\\): beta.*string"),
        (pandas.concat([FRAME, FRAME.beta], axis=1), "two columns called beta"),
        (FRAME.assign(beta=np.where(FRAME.index == 3, np.nan, FRAME.beta)), "1 values that are not finite"),
        ({"beta": FLAT[:, 1], "stiffness": FLAT[:50, 0]}, "columns of different shapes"),
        (np.ma.masked_less(FLAT, 55.0), "masked value"),
        ({"beta": np.ma.masked_less(FLAT[:, 1], 58.0), "stiffness": FLAT[:, 0]}, "beta: .* masked value"),
        (FLAT.astype(str), "strings such as"),
        ([[1.0, 2.0], [3.0]], "no array"),
        (STRUCTURED[["beta"]], "Add draws of stiffness"),
    ],
)
def test_what_cannot_be_taken_is_refused(draws, words):
    with pytest.raises(InputError, match=words):
        draws_of(draws, NAMES, UNITS)


@pytest.mark.parametrize("text", ["", "stiffness,beta\n", "stiffness,beta\n1.0,2.0\n1.0,2.0,3.0\n"])
def test_a_damaged_table_is_refused(text, tmp_path):
    file = tmp_path / "draws.csv"
    file.write_text(text)
    with pytest.raises(InputError):
        draws_of(file, NAMES, UNITS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda lines: lines[1:], "numbers in the first line. Expected: a heading line: stiffness, beta"),
        (lambda lines: [*lines[:51], f"stuck,{lines[51].split(',')[1]}", *lines[52:]], "draw 51: stiffness is 'stuck'"),
    ],
)
def test_a_table_says_which_line_is_no_draw(tmp_path, change, said):
    file = tmp_path / "draws.csv"
    lines = ["stiffness,beta", *(f"{k!r},{b!r}" for k, b in FLAT.tolist())]
    file.write_text("\n".join(change(lines)))
    with pytest.raises(InputError) as refusal:
        draws_of(file, NAMES, UNITS)
    assert said in str(refusal.value)
