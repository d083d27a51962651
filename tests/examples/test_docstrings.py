"""Every public name, and everything that a user may extend, shows its use; what the example prints is right."""

import doctest

import pytest

import structid as si
from structid.inference.error_models.base import Discrepancy
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models.base import Model
from structid.models.model_kind import ModelKind
from structid.models.traceable import TraceableModel
from structid.report.section import Section
from structid.study.stages.stage import StudyStage
from structid.surrogates.base import Surrogate
from structid.surrogates.surrogate_kind import SurrogateKind

OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
PUBLIC = [getattr(si, name) for name in si.__all__ if name not in ("__version__", "optimize")]
EXTENDED = [
    *(Model, TraceableModel, ModelKind, Surrogate, SurrogateKind, Discrepancy, ErrorModelKind),
    *(Sampler, SamplerKind, Section, StudyStage),
]


@pytest.mark.parametrize("thing", [*PUBLIC, *EXTENDED], ids=lambda thing: thing.__name__)
def test_the_example_of_a_name(thing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = thing.__name__
    examples = doctest.DocTestParser().get_doctest(thing.__doc__, {}, name, None, None)
    assert examples.examples, f"{name} has no example"
    printed = []
    result = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(examples, out=printed.append)
    assert result.failed == 0, "".join(printed)
