"""A section of somebody else's."""

from structid.report.section import Section, Table


def _tables(material):
    count = str(len(material.result.flat))
    return [Table("How many draws there are", (["what", "count"], [["draws", count]]))]


SECTION = Section("draws", "A section of my own", lambda material: [], _tables, lambda material: ["Words of my own."])
