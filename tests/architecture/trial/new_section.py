"""A section of somebody else's: it shows the result of a stage that only the two know."""

from structid.report.section import Section, Table
from trial.new_stage import LargestResponse


def _tables(material):
    result = material.results.get(LargestResponse)
    if result is None:
        return []
    rows = [["mean", f"{result.peaks.mean():.5f}"], ["draws", str(len(result.peaks))]]
    return [Table(f"Largest {result.channel}", (["what", "value"], rows))]


SECTION = Section(
    "largest-response", "A section of my own", lambda material: [], _tables, lambda material: ["Words of my own."]
)
