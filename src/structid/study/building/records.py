"""Records of a study: read or simulated, then processed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from structid.core.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.study.schema.static_tables import RecordTable


def load_record(section: RecordTable, folder: Path, where: str) -> GroundMotion:
    """Read or simulate a record and process it."""
    return processed(read_record(section, folder, where), section, where)


def read_record(section: RecordTable, folder: Path, where: str) -> GroundMotion:
    """Read or simulate a record."""
    if (section.file is None) == (section.synthetic is None):
        came = "neither file nor synthetic" if section.file is None else "both file and synthetic"
        raise InputError(f"key '{where}'", came, "exactly one of the two")
    if section.synthetic is not None:
        record = GroundMotion.synthetic(**section.synthetic.model_dump())
    else:
        assert section.file is not None
        record = GroundMotion.read(
            folder / section.file,
            section.dt,
            section.unit,
            section.column,
            component=section.component,
            time_column=section.time_column,
        )
    return replace(record, name=section.name) if section.name else record


def processed(record: GroundMotion, section: RecordTable, where: str) -> GroundMotion:
    """Process a record: baseline, filters, resampling, trim, scale, in this order."""
    if section.baseline is not None:
        record = record.baseline(section.baseline)
    order = section.filter_order
    if section.highpass is not None and section.lowpass is not None:
        record = record.bandpass(section.highpass, section.lowpass, order or 4)
    elif section.highpass is not None:
        record = record.highpass(section.highpass, order or 4)
    elif section.lowpass is not None:
        record = record.lowpass(section.lowpass, order)
    if section.resample is not None:
        record = record.resample(section.resample)
    if section.trim is not None:
        record = record.trim(*section.trim)
    if section.pga is not None and section.scale is not None:
        raise InputError(f"key '{where}'", "both pga and scale", "one of the two")
    if section.pga is not None:
        return record.scale_to_pga(section.pga)
    return record if section.scale is None else record.scale(section.scale)
