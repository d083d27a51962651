"""The rules of `tools/check_style.py` find what breaks them."""

import ast

import pytest

import check_style

WRONG = '''"""No sentence"""

def solve(model):
    """Solve it [3.12], doi 10.1000/nowhere.

    Parameters
    ----------
    modle : object
        The model.
    """
    print(isinstance(model, BoucWen))
'''


@pytest.fixture
def wrong_package(tmp_path, monkeypatch):
    """A package of two files, each of which breaks every rule that a text can break, and a page that does, too."""
    for folder in ("one", "two", "study"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / ("solve.py" if folder != "study" else "kinds.py")).write_text(WRONG)
    (tmp_path / "study" / "kinds.py").write_text('"""Kinds."""\nKIND = "pod_kriging"\n')
    for file in (
        *("surrogates/storage.py", "surrogates/base.py", "calibration/sequential.py"),
        *("docs/bibliography.md", "tests/test_a.py"),
    ):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text('"""Nothing."""\n')
    (tmp_path / "tests" / "nowhere").mkdir()
    (tmp_path / "tests" / "nowhere" / "test_a.py").write_text("")
    (tmp_path / "docs" / "page.md").write_text(
        "[link](nowhere.md)\n\n```python\nx = (\n```\n\n```toml\na = \n```\n\n```sh\nstructid fly\nstructid run --fast\n```\n"
    )
    files = [file for room in ("one", "two", "study") for file in (tmp_path / room).glob("*.py")]
    trees = {file: ast.parse(file.read_text()) for file in files}
    for name, value in {
        "SRC": tmp_path,
        "DOCS": tmp_path / "docs",
        "TESTS": tmp_path / "tests",
        "package_files": lambda: trees,
        "pages": lambda: {tmp_path / "docs" / "page.md": (tmp_path / "docs" / "page.md").read_text()},
    }.items():
        monkeypatch.setattr(check_style, name, value)


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        ("unique_file_names", "has the same name"),
        ("rooms_keep_their_classes", "tests for BoucWen of models"),
        ("studies_name_no_surrogate", "names pod_kriging"),
        ("nothing_prints", "prints"),
        ("modules_say_what_they_are_for", "no sentence"),
        ("citations_are_listed", "10.1000/nowhere is not in"),
        ("equation_numbers_say_whose_they_are", r"cites [3.12]"),
        ("examples_parse", "Python that does not compile"),
        ("shell_lines_exist", "run has no --fast"),
        ("links_lead_somewhere", "nowhere.md leads nowhere"),
        ("tests_lie_where_the_code_lies", "test_a.py is there 2 times"),
    ],
)
def test_a_rule_finds_what_breaks_it(rule, words, wrong_package):
    assert words in "\n".join(getattr(check_style, rule)())


def test_docstrings_that_disagree_with_their_signatures_are_found(monkeypatch):
    namespace = {}
    exec(WRONG, namespace)
    monkeypatch.setattr(check_style, "documented_objects", lambda: {"wrong.solve": namespace["solve"]})
    complaints = "\n".join(check_style.docstrings_agree_with_signatures())
    assert "does not describe model" in complaints and "describes modle, which" in complaints


def test_a_public_name_without_its_arguments_is_found(monkeypatch):
    monkeypatch.setattr(check_style, "documented_parameters", lambda doc: None)
    assert "structid.calibrate: describes none of its arguments" in "\n".join(check_style.public_names_are_documented())


def test_the_reader_of_citations_reads_them():
    assert check_style.dois("(A. Body 1983, doi 10.1007/BF01033232).") == {"10.1007/BF01033232"}
    split = "doi 10.1061/(ASCE)0733-9399(2007)133:7(816). Next"
    assert check_style.dois(split) == {"10.1061/(ASCE)0733-9399(2007)133:7(816)"}
    assert check_style.dois("2018,\narXiv 1804.06788), half") == set()
    assert check_style.arxiv_numbers("2018,\narXiv 1804.06788), and arXiv\n2402.10797.") == {"1804.06788", "2402.10797"}
    assert check_style.EQUATION.search("J(θ) [3.22]") and not check_style.EQUATION.search("in [0.5, 2.0]")
